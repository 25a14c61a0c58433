// SPDX-License-Identifier: GPL-2.0-or-later
// Property: what the writer writes, the reader reads back as the same message, without a finding.
#include "messages/profile_writer.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "common/ids.hpp"
#include "messages/profile_reader.hpp"
#include "messages/values.hpp"

namespace axon {
namespace {

constexpr std::uint64_t kRounds = 2000;

/// Random profiles that keep the rules of docs/reference/profiles.md; the same seed makes the same profile.
class ProfileMaker {
  public:
    explicit ProfileMaker(std::uint64_t seed) : random_(seed) {}

    std::uint64_t below(std::uint64_t limit) { return random_.next() % limit; }
    bool coin() { return below(2) == 0; }

    std::string text(std::size_t longest) {
        static const std::vector<std::string> kPieces = {"a",
                                                         "B",
                                                         "7",
                                                         " ",
                                                         "&",
                                                         "<",
                                                         ">",
                                                         "\"",
                                                         "'",
                                                         "\n",
                                                         "\t",
                                                         "\r",
                                                         "]]>",
                                                         "|",
                                                         "=",
                                                         "/",
                                                         "\xC3\xA9",
                                                         "\xE2\x82\xAC",
                                                         "\xF0\x9F\xA4\x96",
                                                         "&amp;",
                                                         "--"};
        std::string out;
        for (std::uint64_t i = below(longest + 1); i > 0; --i) out += kPieces[below(kPieces.size())];
        return out;
    }

    /// Unique by its number; without white space at its ends.
    std::string name(int number) {
        std::string out = "n" + std::to_string(number) + "_" + text(8) + ".";
        for (char& c : out)
            if (c == '\n' || c == '\t' || c == '\r') c = ' ';
        return out;
    }

    double real() {
        const double magnitude = std::pow(10.0, static_cast<double>(below(40)) - 20);
        return (static_cast<double>(random_.next()) / 1e19 - 0.9) * magnitude;
    }

    proto::Value value(proto::DataType type) {
        proto::Value out;
        switch (type) {
            case proto::INT:
                out.set_int_(static_cast<std::int64_t>(random_.next() >> below(64)));
                break;
            case proto::DBL:
                out.set_dbl(real());
                break;
            case proto::BOOL:
                out.set_bool_(coin());
                break;
            default:
                out.set_str(text(12));
                break;
        }
        return out;
    }

    proto::CtrlParam param(int number) {
        proto::CtrlParam out;
        out.set_name(name(number));
        out.set_type(static_cast<proto::ParamType>(below(4)));
        out.set_data_type(static_cast<proto::DataType>(1 + below(4)));
        if (coin()) out.set_units("mm/s");
        if (coin()) out.set_descr(text(20));
        out.set_savable(coin() || out.type() == proto::CONFIG);
        out.set_multiple(coin());
        out.set_required(coin() && (out.type() == proto::INPUT || out.type() == proto::CONFIG));
        const bool with_choices = out.data_type() != proto::BOOL && below(4) == 0;
        for (std::uint64_t i = with_choices ? 1 + below(4) : 0; i > 0; --i) {
            const auto choice = value(out.data_type());
            bool fresh = true;
            for (const auto& other : out.choices()) fresh = fresh && !equalValues(other, choice);
            if (fresh) *out.add_choices() = choice;
        }
        const std::uint64_t values = out.multiple() ? below(5) : below(2);
        for (std::uint64_t i = 0; i < values; ++i) {
            const int choices = out.choices_size();
            *out.add_initial() =
                choices > 0 ? out.choices(static_cast<int>(below(static_cast<std::uint64_t>(choices))))
                            : value(out.data_type());
        }
        if (coin() && (out.data_type() == proto::INT || out.data_type() == proto::DBL)) addRange(out);
        out.set_ready(out.initial_size() > 0);
        return out;
    }

    proto::ServicesProfile services() {
        proto::ServicesProfile out;
        const int count = 1 + static_cast<int>(below(6));
        for (int i = 0; i < count; ++i) {
            auto& service = *out.add_services();
            service.set_id(i);
            service.set_name(name(i));
            if (coin()) service.set_global_id("g" + std::to_string(i));
            service.set_is_active(coin());
            service.set_is_blocking(coin());
            service.set_is_pausable(coin());
            if (coin()) service.set_descr(text(20));
            if (coin()) service.set_notes(text(20));
            service.set_on_client_loss(static_cast<proto::OnClientLoss>(below(3)));
            if (service.on_client_loss() == proto::HOLD_TASK) service.set_is_pausable(true);
            if (service.on_client_loss() == proto::FINISH_TASK)
                service.set_max_duration_s(1 + static_cast<double>(below(1000)) / 7);
            for (int p = static_cast<int>(below(5)); p > 0; --p) *service.add_params() = param(p);
            for (int r = static_cast<int>(below(3)); r > 0; --r) {
                auto& resource = *service.add_resources();
                resource.set_name(name(r));
                if (coin()) resource.set_url((coin() ? "/srv/files/r" : "files/r") + std::to_string(r));
                resource.set_ready(coin());
                resource.set_required(coin());
                resource.set_savable(coin());
                if (coin()) resource.set_descr(text(10));
            }
            // References go to services above, so that no circle closes.
            if (i > 0 && coin()) {
                service.set_type(proto::CMPLX);
                service.clear_params();
                const std::uint64_t parts = 1 + below(3);
                for (std::uint64_t r = 0; r < parts; ++r) {
                    const auto& part = out.services(static_cast<int>(below(static_cast<std::uint64_t>(i))));
                    service.add_service_list(part.name());
                    // Of its own only what suits its one part.
                    if (parts > 1) continue;
                    for (const auto& theirs : part.params())
                        if (theirs.type() == proto::INPUT || theirs.type() == proto::CONFIG)
                            *service.add_params() = theirs;
                }
            }
        }
        return out;
    }

    proto::BasicProfile basic() {
        proto::BasicProfile out;
        out.set_name(name(0));
        out.set_category(coin() ? proto::ROBOT : proto::MACHINE);
        out.set_type(coin() ? proto::MOBILE : proto::STATIONARY);
        out.set_descr(text(30));
        out.set_xpos(real());
        out.set_ypos(real());
        out.set_zpos(coin() ? 0 : real());
        return out;
    }

    proto::GlobalProfile global() {
        proto::GlobalProfile out;
        for (int i = static_cast<int>(below(4)); i > 0; --i) {
            auto& service = *out.add_services();
            service.set_name(name(i));
            if (coin()) service.set_descr(text(10));
            for (std::uint64_t s = 1 + below(4); s > 0; --s) globalStep(service);
            service.set_on_failure(static_cast<proto::OnFailure>(below(3)));
            if (service.on_failure() != proto::COMPENSATE) continue;
            const auto& compensated =
                service.steps(static_cast<int>(below(static_cast<std::uint64_t>(service.steps_size()))));
            auto& step = *service.add_compensation();
            step.set_role(compensated.role());
            step.set_category(compensated.category());
            step.set_type(compensated.type());
            step.set_service_global_id(name(0));
            addParams(step);
        }
        return out;
    }

  private:
    void addParams(proto::GlobalStep& step) {
        for (int p = static_cast<int>(below(3)); p > 0; --p) {
            auto& param = *step.add_params();
            param.set_name(name(p));
            param.add_values()->set_str(text(10));
        }
    }

    /// Its place in the order is not below that of the step before it, from which it may have a value.
    void globalStep(proto::GlobalService& service) {
        const int before = service.steps_size();
        auto& step = *service.add_steps();
        step.set_role(static_cast<int>(below(3)));
        step.set_category(step.role() == 0 ? proto::ROBOT : proto::MACHINE);
        step.set_type(step.role() == 1 ? proto::MOBILE : proto::STATIONARY);
        step.set_preced(static_cast<int>(below(2)) + (before > 0 ? service.steps(before - 1).preced() : 0));
        step.set_service_global_id(name(0));
        if (coin()) {
            std::string called = name(before);
            std::erase(called, '.');
            step.set_name(called.substr(0, called.find_last_not_of(' ') + 1));
        }
        addParams(step);
        for (int earlier = 0; earlier < before; ++earlier) {
            const auto& from = service.steps(earlier);
            if (from.name().empty() || from.preced() >= step.preced() || coin()) continue;
            auto& source = *step.add_sources();
            source.set_param(name(100 + earlier));
            source.set_step(from.name());
            source.set_output(name(earlier));
        }
    }

    /// Limits around all values that the parameter already has.
    void addRange(proto::CtrlParam& param) {
        double low = 0;
        double high = 0;
        const auto widen = [&](const proto::Value& value) {
            const double number = value.has_int_() ? static_cast<double>(value.int_()) : value.dbl();
            low = std::min(low, std::nextafter(number, -INFINITY));
            high = std::max(high, std::nextafter(number, INFINITY));
        };
        for (const auto& value : param.initial()) widen(value);
        for (const auto& value : param.choices()) widen(value);
        if (coin()) param.set_minimum(low);
        if (coin()) param.set_maximum(high);
    }

    SeededRandom random_;
};

template <class Message, class Make, class Write, class Read>
void expectRoundTrips(const Make& make, const Write& write, const Read& read) {
    for (std::uint64_t seed = 1; seed <= kRounds; ++seed) {
        ProfileMaker maker(seed);
        const Message message = make(maker);
        const std::string xml = write(message);
        const auto reading = read(xml, "random.xml");
        ASSERT_TRUE(reading.findings.empty())
            << "seed " << seed << ": " << reading.findings[0].toString() << "\n"
            << xml;
        ASSERT_EQ(reading.message.SerializeAsString(), message.SerializeAsString())
            << "seed " << seed << "\n"
            << xml << reading.message.DebugString() << message.DebugString();
    }
}

TEST(ProfileRoundTrip, BasicProfilesSurvive) {
    expectRoundTrips<proto::BasicProfile>([](ProfileMaker& maker) { return maker.basic(); },
                                          writeBasicProfile, readBasicProfile);
}

TEST(ProfileRoundTrip, ServicesProfilesSurvive) {
    expectRoundTrips<proto::ServicesProfile>([](ProfileMaker& maker) { return maker.services(); },
                                             writeServicesProfile, readServicesProfile);
}

TEST(ProfileRoundTrip, GlobalProfilesSurvive) {
    expectRoundTrips<proto::GlobalProfile>([](ProfileMaker& maker) { return maker.global(); },
                                           writeGlobalProfile, readGlobalProfile);
}

TEST(ProfileWriter, WhatXmlCannotHoldBecomesAQuestionMark) {
    proto::BasicProfile profile;
    profile.set_name("Arm");
    profile.set_category(proto::ROBOT);
    profile.set_type(proto::MOBILE);
    profile.set_descr(std::string("a\x01\xEF\xBF\xBF") + "b");
    const auto reading = readBasicProfile(writeBasicProfile(profile), "arm.xml");
    EXPECT_TRUE(reading.ok());
    EXPECT_EQ(reading.message.descr(), "a??b");
}

}  // namespace
}  // namespace axon

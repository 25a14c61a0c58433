// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/outbox/forward.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

namespace axon::transport {
namespace {

using testing::ElementsAre;

/// As Ice generates a proxy: of each operation a second form, which is a template.
class FakePrx {
  public:
    std::function<void()> messageAsync(const ice::Header& head, const ByteRange& bytes, Answered answered,
                                       Failed, Sent, const Ice::Context&) {
        calls.push_back("message " + head.entity + " " + std::string(toView(bytes)));
        std::exchange(answered, nullptr)();
        return {};
    }
    template <class = void>
    int messageAsync(const ice::Header&, const ByteRange&, const Ice::Context& = Ice::noExplicitContext) {
        return 0;
    }
    std::function<void()> laneAsync(ice::Lane lane, const ice::Header& head, const ByteRange& bytes, Answered,
                                    Failed, Sent, const Ice::Context&) {
        calls.push_back((lane == ice::Lane::Signal ? "signal " : "data ") + head.entity + " " +
                        std::string(toView(bytes)));
        return {};
    }
    std::function<void()> signalAsync(const ice::Header& head, Answered, Failed failed, Sent,
                                      const Ice::Context&) {
        calls.push_back("signal " + head.entity);
        std::exchange(failed, nullptr)(nullptr);
        return {};
    }
    std::function<void()> refusalAsync(const ice::Header& head, int code, const std::string& reason, Answered,
                                       Failed, Sent, const Ice::Context&) {
        calls.push_back("refusal " + head.entity + " " + std::to_string(code) + " " + reason);
        return {};
    }
    std::function<void()> profileAsync(const std::string& name, const ByteRange& bytes, Answered, Failed,
                                       Sent, const Ice::Context&) {
        calls.push_back("profile " + name + " " + std::string(toView(bytes)));
        return {};
    }
    std::function<void()> beatAsync(double number, Answered, Failed, Sent sent, const Ice::Context&) {
        calls.push_back("beat " + std::to_string(static_cast<int>(number)));
        std::exchange(sent, nullptr)(true);
        return {};
    }

    std::vector<std::string> calls;
};

TEST(Forward, GivesAnOperationWhatItDeclaresInItsOrder) {
    FakePrx prx;
    ice::Header head;
    head.entity = "e1";
    const auto bytes = toRange("bytes");
    forward<FakePrx>(&FakePrx::laneAsync, ice::Lane::Signal)(prx, head, bytes, {}, {}, {});
    forward<FakePrx>(&FakePrx::refusalAsync, 7, std::string("no"))(prx, head, bytes, {}, {}, {});
    forward<FakePrx>(&FakePrx::profileAsync, std::string("Robot"))(prx, head, bytes, {}, {}, {});
    EXPECT_THAT(prx.calls, ElementsAre("signal e1 bytes", "refusal e1 7 no", "profile Robot bytes"));
}

TEST(Forward, HandsOverWhatIsToBeToldOfTheEnd) {
    FakePrx prx;
    std::string told;
    const Answered answered = [&] { told += "answered "; };
    const Failed failed = [&](const std::exception_ptr&) { told += "failed "; };
    const Sent sent = [&](bool) { told += "sent"; };
    forward<FakePrx> (&FakePrx::messageAsync)(prx, {}, toRange("?"), answered, failed, sent);
    forward<FakePrx> (&FakePrx::signalAsync)(prx, {}, toRange("?"), answered, failed, sent);
    forward<FakePrx>(&FakePrx::beatAsync, 3.0)(prx, answered, failed, sent);
    EXPECT_EQ(told, "answered failed sent");
    EXPECT_THAT(prx.calls, ElementsAre("message  ?", "signal ", "beat 3"));
}

}  // namespace
}  // namespace axon::transport

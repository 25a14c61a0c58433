// SPDX-License-Identifier: MIT
// How a global services profile is read: services that several entities carry out together, in steps.
#include "messages/profile_elements.hpp"

namespace axon::profiles {
namespace {

const std::vector<Spelling<proto::OnFailure>> kOnFailure = {
    {"stop-all", proto::STOP_ALL}, {"hold-others", proto::HOLD_OTHERS}, {"compensate", proto::COMPENSATE}};

/// The services of a global services profile. What refers to something else in its service (an output of an
/// earlier step, the participant of a compensation) is judged when the whole service has been read.
class GlobalReader {
  public:
    explicit GlobalReader(Findings& findings) : findings_(findings) {}

    proto::GlobalProfile read(const XmlElement& root) {
        Reader reader(root, findings_);
        proto::GlobalProfile profile;
        UniqueNames names("a service name");
        reader.children({"Service"}, [&](const XmlElement& element) {
            readService(element, names, *profile.add_services());
        });
        reader.statedCount("count", static_cast<std::size_t>(profile.services_size()), "services");
        reader.reportUnknownAttributes();
        return profile;
    }

  private:
    static constexpr int kMaxSteps = 1000;
    static constexpr std::size_t kMaxRoles = 256;
    static constexpr std::size_t kMaxStepNameBytes = 128;

    struct Role {
        int line = 0;
        proto::Category category = proto::CATEGORY_UNSPECIFIED;
        proto::Mobility type = proto::MOBILITY_UNSPECIFIED;

        bool known() const { return category != 0 && type != 0; }
    };
    /// One `param_from`, in the order of the sources of all steps.
    struct Source {
        const XmlAttribute* attribute = nullptr;
        std::string element;
    };

    void readService(const XmlElement& element, UniqueNames& names, proto::GlobalService& service) {
        Reader reader(element, findings_);
        service.set_name(reader.name("name"));
        if (!service.name().empty()) reader.nameIt(service.name());
        names.claim(reader, "name", service.name());
        service.set_descr(reader.text("descr"));
        const bool states_reaction = reader.take("on_failure") != nullptr;
        const auto reaction = reader.choice("on_failure", kOnFailure, false);
        if (reaction) service.set_on_failure(*reaction);
        reader.reportUnknownAttributes();

        roles_.clear();
        sources_.clear();
        UniqueNames step_names("a step's name");
        std::vector<const XmlElement*> compensations;
        reader.children({"entity", "compensate"}, [&](const XmlElement& item) {
            if (item.name == "compensate")
                compensations.push_back(&item);
            else
                readStep(item, service, step_names);
        });
        if (service.steps_size() == 0)
            reader.error(reader.line(), {}, "at least one <entity> step", "add one, or remove the service");
        if (service.steps_size() > kMaxSteps)
            reader.error(reader.line(), {},
                         "at most " + std::to_string(kMaxSteps) + " steps, found " +
                             std::to_string(service.steps_size()),
                         "divide it into several services");
        if (roles_.size() > kMaxRoles)
            reader.error(reader.line(), {},
                         "at most " + std::to_string(kMaxRoles) + " participants (different ids), found " +
                             std::to_string(roles_.size()),
                         "give steps of the same participant the same id, or divide the service");
        checkSources(service);

        std::map<int, int> compensated;
        for (const auto* item : compensations) readCompensation(*item, service, compensated);
        if (service.on_failure() == proto::COMPENSATE && compensations.empty())
            reader.error(reader.lineOf("on_failure"), "on_failure",
                         "at least one <compensate> beside \"compensate\"",
                         "add <compensate id=\"...\" service_global_id=\"...\"/> after the steps, or leave "
                         "on_failure out");
        if (service.on_failure() != proto::COMPENSATE && !compensations.empty() &&
            (reaction || !states_reaction))
            reader.warning(compensations.front()->line, {},
                           "on_failure=\"compensate\" beside <compensate>; without it no compensation runs",
                           "add on_failure=\"compensate\", or remove <compensate>");
    }

    int wholeNumber(Reader& reader, std::string_view attribute, std::string_view what) {
        if (reader.take(attribute) == nullptr) reader.missing(attribute, std::string(what));
        return reader.count(attribute, what).value_or(0);
    }

    void readStep(const XmlElement& element, proto::GlobalService& service, UniqueNames& step_names) {
        Reader reader(element, findings_);
        auto& step = *service.add_steps();
        step.set_service_global_id(reader.name("service_global_id"));
        if (!step.service_global_id().empty()) reader.nameIt(step.service_global_id());
        step.set_name(stepName(reader));
        step_names.claim(reader, "name", step.name());
        if (const auto category = reader.choice("category", kCategories, true)) step.set_category(*category);
        if (const auto type = reader.choice("type", kMobilities, true)) step.set_type(*type);
        step.set_role(wholeNumber(reader, "id", "the number of a participant"));
        step.set_preced(wholeNumber(reader, "preced", "the step's place in the order"));
        UniqueNames names("a parameter name");
        reader.children({"key_value"}, [&](const XmlElement& item) {
            Reader pair(item, findings_);
            const auto name = paramName(pair, names);
            const auto* value = pair.take("param_value");
            const auto* from = pair.take("param_from");
            if (value != nullptr && from != nullptr)
                pair.error(from->line, "param_from", "either param_value or param_from",
                           "keep one of the two");
            else if (value == nullptr && from == nullptr)
                pair.missing("param_value", "the value of the parameter");
            if (from != nullptr) {
                auto& source = *step.add_sources();
                source.set_param(name);
                const std::string_view text = trimmed(from->value);
                const auto dot = text.find('.');
                source.set_step(std::string(text.substr(0, dot)));
                if (dot != std::string_view::npos) source.set_output(std::string(text.substr(dot + 1)));
                sources_.push_back({from, pair.label()});
            } else {
                auto& param = *step.add_params();
                param.set_name(name);
                if (value != nullptr) param.add_values()->set_str(value->value);
            }
            pair.reportUnknownAttributes();
            pair.children({}, [](const XmlElement&) {});
        });
        reader.reportUnknownAttributes();
        claimRole(reader, step);
    }

    /// Optional; empty where it is unusable, which then is an error already reported.
    std::string stepName(Reader& reader) {
        auto name = reader.name("name", false);
        if (name.find('.') != std::string::npos) {
            reader.error(reader.lineOf("name"), "name",
                         "a step's name without '.', which in param_from ends it; found " + inQuotes(name),
                         "write - or _ instead");
            return {};
        }
        if (name.size() > kMaxStepNameBytes) {
            reader.error(reader.lineOf("name"), "name",
                         "a step's name of at most " + std::to_string(kMaxStepNameBytes) + " bytes, found " +
                             std::to_string(name.size()),
                         "shorten it");
            return {};
        }
        return name;
    }

    std::string paramName(Reader& pair, UniqueNames& names) {
        auto name = pair.name("param_name");
        if (!name.empty()) pair.nameIt(name);
        names.claim(pair, "param_name", name);
        return name;
    }

    void claimRole(Reader& reader, const proto::GlobalStep& step) {
        const Role role{reader.line(), step.category(), step.type()};
        const auto [first, fresh] = roles_.emplace(step.role(), role);
        const auto& same = first->second;
        if (!fresh && role.known() && same.known() &&
            (same.category != role.category || same.type != role.type))
            reader.error(reader.line(), "id",
                         "the category and type of line " + std::to_string(same.line) + ", since id " +
                             std::to_string(step.role()) + " is one participant",
                         "give it the same category and type, or another id");
    }

    void checkSources(const proto::GlobalService& service) {
        std::map<std::string_view, const proto::GlobalStep*> steps;
        std::vector<std::string_view> known;
        for (const auto& step : service.steps()) {
            if (step.name().empty() || !steps.emplace(step.name(), &step).second) continue;
            known.push_back(step.name());
        }
        auto place = sources_.begin();
        for (const auto& step : service.steps()) {
            for (const auto& source : step.sources()) {
                const auto& attribute = *place->attribute;
                const std::string label = (place++)->element + " param_from";
                const auto report = [&](std::string expected, std::string fix) {
                    findings_.error(attribute.line, label, std::move(expected), std::move(fix));
                };
                if (source.step().empty() || source.output().empty()) {
                    report("a step's name, '.', and the name of one of its OUTPUT parameters, found " +
                               inQuotes(attribute.value),
                           "write it as in param_from=\"locate.Position\"");
                    continue;
                }
                const auto found = steps.find(source.step());
                if (found == steps.end()) {
                    const auto near = nearNames(source.step(), known);
                    report("the name of a step of this service before the '.', found " +
                               inQuotes(source.step()) + ": the value can never be there in time",
                           near.empty() ? "give the step that provides it name=\"...\""
                                        : "did you mean " + alternatives(near) + "?");
                } else if (found->second->preced() >= step.preced()) {
                    report("a step with a lower preced than " + std::to_string(step.preced()) + "; that of " +
                               inQuotes(source.step()) + " is " + std::to_string(found->second->preced()) +
                               ": the value can never be there in time",
                           "raise the preced of this step, or lower the other's");
                }
            }
        }
    }

    void readCompensation(const XmlElement& element, proto::GlobalService& service,
                          std::map<int, int>& compensated) {
        Reader reader(element, findings_);
        auto& step = *service.add_compensation();
        step.set_service_global_id(reader.name("service_global_id"));
        if (!step.service_global_id().empty()) reader.nameIt(step.service_global_id());
        if (reader.take("id") == nullptr) reader.missing("id", "the number of a participant");
        if (const auto id = reader.count("id", "the number of a participant")) {
            step.set_role(*id);
            const int line = reader.lineOf("id");
            const auto role = roles_.find(*id);
            const auto [first, fresh] = compensated.emplace(*id, line);
            if (role == roles_.end()) {
                reader.error(
                    line, "id",
                    "the id of a participant, which one of the steps has; found " + std::to_string(*id),
                    "write the id of an <entity> of this service");
            } else if (!fresh) {
                reader.error(line, "id",
                             "one <compensate> for each participant; that of id " + std::to_string(*id) +
                                 " is in line " + std::to_string(first->second),
                             "keep one of the two: it may be a service that is a list of others");
            } else {
                step.set_category(role->second.category);
                step.set_type(role->second.type);
            }
        }
        UniqueNames names("a parameter name");
        reader.children({"key_value"}, [&](const XmlElement& item) {
            Reader pair(item, findings_);
            auto& param = *step.add_params();
            param.set_name(paramName(pair, names));
            const auto* value = pair.take("param_value");
            if (const auto* from = pair.take("param_from"))
                pair.error(from->line, "param_from",
                           "param_value in a compensation: which steps have given their outputs is not "
                           "known when it runs",
                           "write param_value=\"...\" instead");
            else if (value == nullptr)
                pair.missing("param_value", "the value of the parameter");
            if (value != nullptr) param.add_values()->set_str(value->value);
            pair.reportUnknownAttributes();
            pair.children({}, [](const XmlElement&) {});
        });
        reader.reportUnknownAttributes();
    }

    Findings& findings_;
    std::map<int, Role> roles_;  // of the service under reading, as are the sources
    std::vector<Source> sources_;
};

}  // namespace

proto::GlobalProfile readGlobal(const XmlElement& root, Findings& findings) {
    return GlobalReader(findings).read(root);
}

}  // namespace axon::profiles

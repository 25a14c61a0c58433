// SPDX-License-Identifier: MIT
// How a services profile is read: services, their parameters and resources, and which services are made of
// others.
#include <cmath>

#include "messages/composites.hpp"
#include "messages/profile_elements.hpp"

namespace axon::profiles {
namespace {

constexpr std::size_t kMaxChoices = 256;  // each value is compared with each choice
constexpr double kLongestDuration_s = 24 * 3600;

const std::vector<Spelling<proto::ServiceType>> kServiceTypes = {
    {"SMPL", proto::SMPL},
    {"CMPLX", proto::CMPLX},
    {"CPLX", proto::CMPLX, "write CMPLX; CPLX is figure 3.4's spelling of it"}};
const std::vector<Spelling<proto::ParamType>> kParamTypes = {
    {"INPUT", proto::INPUT},
    {"OUTPUT", proto::OUTPUT},
    {"CONFIG", proto::CONFIG},
    {"FEEDBACK", proto::FEEDBACK},
    {"SMPL", proto::FEEDBACK,
     "write FEEDBACK; the thesis lists SMPL where it describes a feedback parameter"}};
const std::vector<Spelling<proto::DataType>> kDataTypes = {
    {"INT", proto::INT}, {"DBL", proto::DBL}, {"STR", proto::STR}, {"BOOL", proto::BOOL}};
const std::vector<Spelling<proto::OnClientLoss>> kOnClientLoss = {
    {"stop", proto::STOP_TASK}, {"hold", proto::HOLD_TASK}, {"finish", proto::FINISH_TASK}};

/// The texts of <Values> or <Choices>.
std::vector<std::pair<std::string, int>> readTexts(const XmlElement& list, std::string_view item,
                                                   Findings& findings) {
    std::vector<std::pair<std::string, int>> texts;
    Reader reader(list, findings);
    reader.children({item}, [&](const XmlElement& element) {
        Reader item_reader(element, findings);
        if (!element.children.empty())
            item_reader.error(element.children.front().line, {}, "text only in " + element.name,
                              "write < as &lt; where it is meant as text");
        item_reader.reportUnknownAttributes();
        texts.emplace_back(element.text, element.line);
    });
    reader.reportUnknownAttributes();
    return texts;
}

class ParamReader {
  public:
    ParamReader(const XmlElement& element, Findings& findings) : reader_(element, findings) {}

    Reader& reader() { return reader_; }

    proto::CtrlParam read() {
        param_.set_name(reader_.name("name"));
        if (!param_.name().empty()) reader_.nameIt(param_.name());
        if (const auto type = reader_.choice("type", kParamTypes, true)) param_.set_type(*type);
        if (const auto type = reader_.choice("data_type", kDataTypes, true)) param_.set_data_type(*type);
        param_.set_units(std::string(trimmed(reader_.text("units"))));
        param_.set_descr(reader_.text("descr"));
        param_.set_required(reader_.flag("required", false));
        param_.set_savable(reader_.flag("savable", "modifiable", param_.type() == proto::CONFIG));
        param_.set_multiple(reader_.flag("multiple", false));
        const bool stated_ready = reader_.flag("ready", "set", false);
        const bool states_ready = has("ready") || has("set");
        readRange();
        collectTexts();
        readChoices();
        readValues();
        param_.set_ready(param_.initial_size() > 0);
        checkFlags(states_ready, stated_ready);
        reader_.reportUnknownAttributes();
        return std::move(param_);
    }

  private:
    bool has(std::string_view attribute) const {
        const auto& all = reader_.element().attributes;
        return std::any_of(all.begin(), all.end(), [&](const auto& a) { return a.name == attribute; });
    }

    bool numeric() const { return param_.data_type() == proto::INT || param_.data_type() == proto::DBL; }

    void readRange() {
        const auto minimum = reader_.number("minimum", "the smallest value allowed, a number");
        const auto maximum = reader_.number("maximum", "the largest value allowed, a number");
        if (!minimum && !maximum) return;
        if (param_.data_type() != proto::DATA_TYPE_UNSPECIFIED && !numeric()) {
            const char* attribute = minimum ? "minimum" : "maximum";
            reader_.error(reader_.lineOf(attribute), attribute, "a range only for INT and DBL",
                          "remove minimum and maximum");
            return;
        }
        if (minimum && maximum && *minimum > *maximum) {
            reader_.error(reader_.lineOf("minimum"), "minimum", "a minimum that is not above the maximum",
                          "exchange the two");
            return;
        }
        if (minimum) param_.set_minimum(*minimum);
        if (maximum) param_.set_maximum(*maximum);
    }

    void collectTexts() {
        if (const auto* attribute = reader_.take("choices")) {
            std::string_view rest = attribute->value;
            while (true) {
                const auto bar = rest.find('|');
                choices_.emplace_back(std::string(trimmed(rest.substr(0, bar))), attribute->line);
                if (bar == std::string_view::npos) break;
                rest.remove_prefix(bar + 1);
            }
        }
        int value_lists = 0;
        reader_.children({"Values", "Choices"}, [&](const XmlElement& list) {
            if (list.name == "Choices") {
                if (!choices_.empty())
                    reader_.error(list.line, {}, "the choices once",
                                  "keep either the attribute choices or one <Choices>");
                for (auto& text : readTexts(list, "Choice", reader_.findings()))
                    choices_.push_back(std::move(text));
                if (list.children.empty())
                    reader_.error(list.line, {}, "at least one <Choice> in <Choices>",
                                  "add one, or remove <Choices>");
            } else {
                if (++value_lists > 1)
                    reader_.error(list.line, {}, "the values once", "put all <Value> in one <Values>");
                for (auto& text : readTexts(list, "Value", reader_.findings()))
                    values_.push_back(std::move(text));
            }
        });
        if (value_lists > 0 && !param_.multiple())
            reader_.error(reader_.line(), {}, "a list of values only where multiple=\"true\"",
                          "add multiple=\"true\", or write one value=\"...\"");
        if (const auto* attribute = reader_.take("value")) {
            if (value_lists > 0) {
                reader_.error(attribute->line, "value", "either value or <Values>", "keep one of the two");
            } else if (trimmed(attribute->value).empty() && param_.data_type() != proto::STR) {
                reader_.warning(attribute->line, "value", "a value, found nothing; it counts as not set",
                                "leave the attribute out");
            } else {
                values_.emplace_back(attribute->value, attribute->line);
            }
        }
    }

    void readChoices() {
        if (choices_.empty() || param_.data_type() == proto::DATA_TYPE_UNSPECIFIED) return;
        if (param_.data_type() == proto::BOOL) {
            reader_.error(choices_.front().second, "choices",
                          "choices only for INT, DBL and STR; a BOOL has its two", "remove the choices");
            return;
        }
        if (choices_.size() > kMaxChoices) {
            reader_.error(choices_.front().second, "choices",
                          "at most " + std::to_string(kMaxChoices) + " choices, found " +
                              std::to_string(choices_.size()),
                          "give a range by minimum and maximum instead");
            return;
        }
        proto::CtrlParam without_choices = param_;
        for (const auto& [text, line] : choices_) {
            auto value = acceptable(without_choices, text, line, "choices");
            if (!value) continue;
            const bool repeated =
                std::any_of(param_.choices().begin(), param_.choices().end(),
                            [&](const auto& choice) { return equalValues(choice, *value); });
            if (repeated) {
                reader_.warning(line, "choices", "each choice once, found " + inQuotes(text) + " again",
                                "remove it");
            } else {
                *param_.add_choices() = std::move(*value);
            }
        }
    }

    void readValues() {
        if (param_.data_type() == proto::DATA_TYPE_UNSPECIFIED) return;
        for (const auto& [text, line] : values_) {
            if (auto value = acceptable(param_, text, line, "value"))
                *param_.add_initial() = std::move(*value);
        }
    }

    std::optional<proto::Value> acceptable(const proto::CtrlParam& meta, const std::string& text, int line,
                                           std::string_view attribute) {
        auto value = parseValue(meta, text);
        if (!value) {
            reader_.error(line, attribute, describeValues(meta) + ", found " + inQuotes(text),
                          "write such a value, or change data_type");
            return {};
        }
        if (!checkValue(meta, value.value()).ok()) {
            reader_.error(line, attribute, describeValues(meta) + ", found " + inQuotes(text),
                          "write an allowed value, or allow this one (minimum, maximum, choices)");
            return {};
        }
        return std::move(value).value();
    }

    void checkFlags(bool states_ready, bool stated_ready) {
        const char* spelling = has("ready") ? "ready" : "set";
        if (states_ready && stated_ready && values_.empty())
            reader_.warning(reader_.lineOf(spelling), spelling,
                            "a value, since it says that the value is set; it counts as not set",
                            "add value=\"...\", or leave the attribute out");
        if (states_ready && !stated_ready && !values_.empty())
            reader_.warning(reader_.lineOf(spelling), spelling,
                            "true, since there is a value; it counts as set",
                            "remove the value, or leave the attribute out");
        const bool comes_from_robot = param_.type() == proto::OUTPUT || param_.type() == proto::FEEDBACK;
        if (param_.required() && comes_from_robot) {
            reader_.warning(reader_.lineOf("required"), "required",
                            "required only for INPUT and CONFIG; it is ignored",
                            "leave the attribute out: the robot gives this value");
            param_.set_required(false);
        }
        if (param_.type() == proto::CONFIG && !param_.savable()) {
            const char* attribute = has("savable") ? "savable" : "modifiable";
            reader_.warning(reader_.lineOf(attribute), attribute,
                            "true for CONFIG, whose value is always kept; it counts as true",
                            "leave the attribute out, or make the parameter an INPUT");
            param_.set_savable(true);
        }
    }

    Reader reader_;
    proto::CtrlParam param_;
    std::vector<std::pair<std::string, int>> values_;
    std::vector<std::pair<std::string, int>> choices_;
};

proto::Resource readResource(Reader& reader) {
    proto::Resource resource;
    resource.set_name(reader.name("name"));
    if (!resource.name().empty()) reader.nameIt(resource.name());
    if (const auto* url = reader.take("url"); url != nullptr) {
        resource.set_url(std::string(trimmed(url->value)));
        if (const auto refusal = checkResourceUrl(resource.url()); !refusal.ok())
            reader.error(url->line, "url", refusal.message,
                         "write a path with / between its steps, or leave the url out: then the Entity "
                         "Manager keeps the file");
    }
    resource.set_descr(reader.text("descr"));
    resource.set_ready(reader.flag("ready", "set", false));
    resource.set_required(reader.flag("required", false));
    resource.set_savable(reader.flag("savable", "modifiable", false));
    reader.reportUnknownAttributes();
    reader.children({}, [](const XmlElement&) {});
    return resource;
}

class ServicesReader {
  public:
    explicit ServicesReader(Findings& findings) : findings_(findings) {}

    proto::ServicesProfile read(const XmlElement& root) {
        Reader reader(root, findings_);
        reader.children({"Service"}, [&](const XmlElement& element) { readService(element); });
        reader.statedCount("count", static_cast<std::size_t>(profile_.services_size()), "services");
        if (profile_.services_size() == 0)
            reader.warning(reader.line(), {}, "at least one <Service>; the entity offers nothing", "add one");
        reader.reportUnknownAttributes();
        checkNames();
        checkComposites();
        return std::move(profile_);
    }

  private:
    struct Reference {
        int service;
        std::string to;
        int line;
    };

    void readService(const XmlElement& element) {
        Reader reader(element, findings_);
        const int id = profile_.services_size();
        auto& service = *profile_.add_services();
        lines_.push_back(element.line);
        service.set_id(id);
        service.set_name(reader.name("name"));
        if (!service.name().empty()) reader.nameIt(service.name());
        names_.claim(reader, "name", service.name());
        service.set_global_id(reader.name("global_id", false));
        global_ids_.claim(reader, "global_id", service.global_id());
        readType(reader, service);
        service.set_is_active(reader.flag("active", true));
        service.set_is_blocking(reader.flag("blocking", true));
        service.set_is_pausable(reader.flag("pausable", false));
        service.set_descr(reader.text("descr"));
        service.set_notes(reader.text("notes"));
        readClientLoss(reader, service);

        UniqueNames param_names("a parameter name");
        UniqueNames resource_names("a resource name");
        std::set<std::string_view> seen;
        bool has_references = false;
        reader.children({"Parameters", "Resources", "Services"}, [&](const XmlElement& list) {
            if (!seen.insert(list.name).second)
                findings_.warning(list.line, list.name + " in " + reader.label(),
                                  "one <" + list.name + "> in each service",
                                  "put the contents of both into one");
            Reader list_reader(list, findings_);
            if (list.name == "Parameters") {
                list_reader.children({"Param"}, [&](const XmlElement& item) {
                    ParamReader param(item, findings_);
                    auto message = param.read();
                    param_names.claim(param.reader(), "name", message.name());
                    *service.add_params() = std::move(message);
                });
            } else if (list.name == "Resources") {
                list_reader.children({"Resource"}, [&](const XmlElement& item) {
                    Reader resource(item, findings_);
                    auto message = readResource(resource);
                    resource_names.claim(resource, "name", message.name());
                    *service.add_resources() = std::move(message);
                });
            } else {
                list_reader.children({"ServiceRef"}, [&](const XmlElement& item) {
                    has_references = true;
                    Reader reference(item, findings_);
                    const auto name = reference.name("name");
                    if (!name.empty()) references_.push_back({id, name, item.line});
                    reference.reportUnknownAttributes();
                    reference.children({}, [](const XmlElement&) {});
                });
            }
            list_reader.reportUnknownAttributes();
        });
        reader.statedCount("parameter_count", static_cast<std::size_t>(service.params_size()), "parameters");
        reader.statedCount("resource_count", static_cast<std::size_t>(service.resources_size()), "resources");
        reader.reportUnknownAttributes();
        checkList(reader, service, seen.contains("Services"), has_references);
    }

    void readType(Reader& reader, proto::Service& service) {
        for (const auto& attribute : reader.element().attributes) {
            if (attribute.name != "type" || trimmed(attribute.value) != "ITRAV") continue;
            (void)reader.take("type");
            reader.error(attribute.line, "type",
                         "one of SMPL, CMPLX; ITRAV stands in figure 3.4 alone, and the thesis says nowhere "
                         "what it does",
                         "write SMPL, or CMPLX with a list of services");
            service.set_type(proto::SMPL);
            type_known_ = false;
            return;
        }
        const auto type = reader.choice("type", kServiceTypes, true);
        type_known_ = type.has_value();
        if (type) service.set_type(*type);
    }

    void readClientLoss(Reader& reader, proto::Service& service) {
        if (const auto reaction = reader.choice("on_client_loss", kOnClientLoss, false))
            service.set_on_client_loss(*reaction);
        if (service.on_client_loss() == proto::HOLD_TASK && !service.is_pausable())
            reader.warning(reader.lineOf("on_client_loss"), "on_client_loss",
                           "pausable=\"true\" beside \"hold\"; without it the task is stopped",
                           "add pausable=\"true\" and an onPause callback, or leave on_client_loss out");
        const bool finish = service.on_client_loss() == proto::FINISH_TASK;
        const bool given = reader.take("max_duration") != nullptr;
        const auto duration = reader.number("max_duration", "a duration in seconds");
        const int line = reader.lineOf("max_duration");
        if (duration && !(*duration > 0 && *duration <= kLongestDuration_s)) {
            reader.error(line, "max_duration", "more than 0 and at most 86400 seconds",
                         "write the longest time a task takes");
        } else if (duration) {
            service.set_max_duration_s(*duration);
            if (!finish)
                reader.warning(line, "max_duration",
                               "on_client_loss=\"finish\" beside it; alone it has no effect",
                               "add on_client_loss=\"finish\", or leave it out");
        } else if (finish && !given) {
            reader.error(
                reader.lineOf("on_client_loss"), "on_client_loss", "max_duration beside \"finish\"",
                "add max_duration=\"...\": the most seconds that a task without its client may go on");
        }
    }

    void checkList(Reader& reader, const proto::Service& service, bool has_list, bool has_references) {
        if (!type_known_) return;
        if (service.type() == proto::SMPL && has_list) {
            reader.error(reader.line(), {}, "a <Services> list only in a service of type CMPLX",
                         "write type=\"CMPLX\", or remove the list");
        } else if (service.type() == proto::CMPLX && !has_references) {
            reader.warning(reader.line(), {}, "a <Services> list in a service of type CMPLX",
                           "add <Services><ServiceRef name=\"...\"/></Services>");
        }
    }

    /// A global id that is another service's name would make requests by that word ambiguous; names win.
    void checkNames() {
        std::map<std::string_view, int> by_name;
        for (const auto& service : profile_.services()) by_name.emplace(service.name(), service.id());
        for (const auto& service : profile_.services()) {
            const auto other = by_name.find(service.global_id());
            if (service.global_id().empty() || other == by_name.end() || other->second == service.id())
                continue;
            findings_.warning(lines_[static_cast<std::size_t>(service.id())],
                              "Service " + inQuotes(service.name()) + " global_id",
                              "a global id that is not the name of another service; requests for " +
                                  inQuotes(service.global_id()) + " go to the service of that name",
                              "change one of the two");
        }
    }

    void checkComposites() {
        std::map<std::string_view, int> positions;
        for (const auto& service : profile_.services())
            if (!service.name().empty()) positions.emplace(service.name(), service.id());
        for (const auto& service : profile_.services())
            if (!service.global_id().empty()) positions.emplace(service.global_id(), service.id());
        std::vector<std::string_view> known;
        for (const auto& [name, position] : positions) known.push_back(name);

        std::vector<std::vector<std::pair<int, int>>> edges(
            static_cast<std::size_t>(profile_.services_size()));
        for (const auto& reference : references_) {
            auto& service = *profile_.mutable_services(reference.service);
            service.add_service_list(reference.to);
            const auto target = positions.find(reference.to);
            if (target != positions.end()) {
                edges[static_cast<std::size_t>(reference.service)].emplace_back(target->second,
                                                                                reference.line);
                continue;
            }
            const auto near = nearNames(reference.to, known);
            findings_.error(
                reference.line, "ServiceRef in Service " + inQuotes(service.name()),
                "the name or global id of a service of this profile, found " + inQuotes(reference.to),
                near.empty() ? "name a service that is declared here"
                             : "did you mean " + alternatives(near) + "?");
        }
        if (reportCycles(edges)) return;
        for (const auto& fault : readComposites(profile_).faults) {
            const int line = lines_[static_cast<std::size_t>(fault.service)];
            const auto element = "Service " + inQuotes(profile_.services(fault.service).name());
            if (fault.error)
                findings_.error(line, element, fault.expected, fault.fix);
            else
                findings_.warning(line, element, fault.expected, fault.fix);
        }
    }

    /// Depth first with an explicit stack: a chain of composites may be as long as the profile.
    bool reportCycles(const std::vector<std::vector<std::pair<int, int>>>& edges) {
        enum class Mark { Fresh, Open, Done };
        std::vector<Mark> marks(edges.size(), Mark::Fresh);
        bool found = false;
        for (std::size_t start = 0; start < edges.size(); ++start) {
            if (marks[start] != Mark::Fresh) continue;
            std::vector<std::pair<std::size_t, std::size_t>> stack{{start, 0}};
            marks[start] = Mark::Open;
            while (!stack.empty()) {
                auto& [service, next] = stack.back();
                if (next == edges[service].size()) {
                    marks[service] = Mark::Done;
                    stack.pop_back();
                    continue;
                }
                const auto [target, line] = edges[service][next++];
                const auto to = static_cast<std::size_t>(target);
                if (marks[to] == Mark::Open) {
                    found = true;
                    findings_.error(line,
                                    "ServiceRef in Service " +
                                        inQuotes(profile_.services(static_cast<int>(service)).name()),
                                    "a composite service that does not contain itself; " +
                                        inQuotes(profile_.services(target).name()) + " contains this one",
                                    "remove the reference that closes the circle");
                } else if (marks[to] == Mark::Fresh) {
                    marks[to] = Mark::Open;
                    stack.emplace_back(to, 0);
                }
            }
        }
        return found;
    }

    Findings& findings_;
    proto::ServicesProfile profile_;
    std::vector<int> lines_;
    std::vector<Reference> references_;
    UniqueNames names_{"a service name"};
    UniqueNames global_ids_{"a global id"};
    bool type_known_ = false;
};

}  // namespace

proto::ServicesProfile readServices(const XmlElement& root, Findings& findings) {
    return ServicesReader(findings).read(root);
}

}  // namespace axon::profiles

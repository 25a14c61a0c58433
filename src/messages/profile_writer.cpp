// SPDX-License-Identifier: MIT
#include "messages/profile_writer.hpp"

#include <string_view>

#include "common/utf8.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon {
namespace {

constexpr std::string_view kHead = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n";

/// Text for an attribute or an element. Line ends and tabs are written as references, or a parser would turn
/// them into spaces.
std::string escaped(std::string_view text) {
    const bool utf8 = isUtf8(text);
    std::string out;
    for (const char c : text) {
        switch (c) {
            case '&':
                out += "&amp;";
                break;
            case '<':
                out += "&lt;";
                break;
            case '>':
                out += "&gt;";
                break;
            case '"':
                out += "&quot;";
                break;
            case '\n':
                out += "&#10;";
                break;
            case '\r':
                out += "&#13;";
                break;
            case '\t':
                out += "&#9;";
                break;
            default: {
                const auto byte = static_cast<unsigned char>(c);
                out += byte < 0x20U || (byte >= 0x80U && !utf8) ? '?' : c;
            }
        }
    }
    // U+FFFE and U+FFFF are valid UTF-8 and still no characters of XML.
    for (const std::string_view barred : {"\xEF\xBF\xBE", "\xEF\xBF\xBF"}) {
        for (auto at = out.find(barred); at != std::string::npos; at = out.find(barred, at))
            out.replace(at, 3, "?");
    }
    return out;
}

class Writer {
  public:
    void attribute(std::string_view name, std::string_view value) {
        out_ += ' ';
        out_ += name;
        out_ += "=\"" + escaped(value) + "\"";
    }
    void text(std::string_view name, std::string_view value) {
        if (!value.empty()) attribute(name, value);
    }
    void flag(std::string_view name, bool value, bool fallback) {
        if (value != fallback) attribute(name, value ? "true" : "false");
    }
    void number(std::string_view name, double value) {
        proto::Value number;
        number.set_dbl(value);
        attribute(name, toText(number));
    }
    void count(std::string_view name, int value) { attribute(name, std::to_string(value)); }

    void open(std::string_view name) {
        indent();
        out_ += '<';
        out_ += name;
        ++depth_;
    }
    void content() { out_ += ">\n"; }
    void closeEmpty() {
        out_ += "/>\n";
        --depth_;
    }
    void close(std::string_view name) {
        --depth_;
        indent();
        out_ += "</";
        out_ += name;
        out_ += ">\n";
    }
    void leaf(std::string_view name, std::string_view value) {
        indent();
        out_ += '<';
        out_ += name;
        out_ += '>' + escaped(value) + "</";
        out_ += name;
        out_ += ">\n";
    }
    std::string take() { return std::move(out_); }

  private:
    void indent() { out_.append(static_cast<std::size_t>(depth_) * 2, ' '); }

    std::string out_{kHead};
    int depth_ = 0;
};

void writeParam(Writer& out, const proto::CtrlParam& param) {
    out.open("Param");
    out.attribute("name", param.name());
    out.attribute("type", proto::ParamType_Name(param.type()));
    out.attribute("data_type", proto::DataType_Name(param.data_type()));
    out.text("units", param.units());
    const bool single = param.initial_size() == 1;
    if (single) out.attribute("value", toText(param.initial(0)));
    out.flag("required", param.required(), false);
    out.flag("savable", param.savable(), param.type() == proto::CONFIG);
    out.flag("multiple", param.multiple(), false);
    if (param.has_minimum()) out.number("minimum", param.minimum());
    if (param.has_maximum()) out.number("maximum", param.maximum());
    out.text("descr", param.descr());
    if (param.initial_size() < 2 && param.choices_size() == 0) return out.closeEmpty();
    out.content();
    if (param.initial_size() > 1) {
        out.open("Values");
        out.content();
        for (const auto& value : param.initial()) out.leaf("Value", toText(value));
        out.close("Values");
    }
    if (param.choices_size() > 0) {
        out.open("Choices");
        out.content();
        for (const auto& choice : param.choices()) out.leaf("Choice", toText(choice));
        out.close("Choices");
    }
    out.close("Param");
}

void writeResource(Writer& out, const proto::Resource& resource) {
    out.open("Resource");
    out.attribute("name", resource.name());
    out.text("url", resource.url());
    out.flag("ready", resource.ready(), false);
    out.flag("required", resource.required(), false);
    out.flag("savable", resource.savable(), false);
    out.text("descr", resource.descr());
    out.closeEmpty();
}

void writeService(Writer& out, const proto::Service& service) {
    out.open("Service");
    out.attribute("name", service.name());
    out.text("global_id", service.global_id());
    out.attribute("type", proto::ServiceType_Name(service.type()));
    out.flag("active", service.is_active(), true);
    out.flag("blocking", service.is_blocking(), true);
    out.flag("pausable", service.is_pausable(), false);
    if (service.on_client_loss() == proto::HOLD_TASK) out.attribute("on_client_loss", "hold");
    if (service.on_client_loss() == proto::FINISH_TASK) out.attribute("on_client_loss", "finish");
    if (service.max_duration_s() != 0) out.number("max_duration", service.max_duration_s());
    out.count("parameter_count", service.params_size());
    out.text("descr", service.descr());
    out.text("notes", service.notes());
    out.content();
    if (service.params_size() > 0) {
        out.open("Parameters");
        out.content();
        for (const auto& param : service.params()) writeParam(out, param);
        out.close("Parameters");
    }
    if (service.resources_size() > 0) {
        out.open("Resources");
        out.content();
        for (const auto& resource : service.resources()) writeResource(out, resource);
        out.close("Resources");
    }
    if (service.service_list_size() > 0) {
        out.open("Services");
        out.content();
        for (const auto& name : service.service_list()) {
            out.open("ServiceRef");
            out.attribute("name", name);
            out.closeEmpty();
        }
        out.close("Services");
    }
    out.close("Service");
}

/// The parameters of a step, and the end of its element.
void writeKeyValues(Writer& out, const proto::GlobalStep& step, std::string_view element) {
    if (step.params_size() == 0 && step.sources_size() == 0) {
        out.closeEmpty();
        return;
    }
    out.content();
    for (const auto& param : step.params()) {
        out.open("key_value");
        out.attribute("param_name", param.name());
        out.attribute("param_value", param.values_size() > 0 ? toText(param.values(0)) : "");
        out.closeEmpty();
    }
    for (const auto& source : step.sources()) {
        out.open("key_value");
        out.attribute("param_name", source.param());
        out.attribute("param_from", source.step() + "." + source.output());
        out.closeEmpty();
    }
    out.close(element);
}

}  // namespace

std::string writeBasicProfile(const proto::BasicProfile& profile) {
    Writer out;
    out.open("BasicProfile");
    out.attribute("name", profile.name());
    out.attribute("category", proto::Category_Name(profile.category()));
    out.attribute("type", proto::Mobility_Name(profile.type()));
    out.text("descr", profile.descr());
    out.number("xpos", profile.xpos());
    out.number("ypos", profile.ypos());
    out.number("zpos", profile.zpos());
    out.closeEmpty();
    return out.take();
}

std::string writeServicesProfile(const proto::ServicesProfile& profile) {
    Writer out;
    out.open("ServiceProfile");
    out.count("count", profile.services_size());
    out.content();
    for (const auto& service : profile.services()) writeService(out, service);
    out.close("ServiceProfile");
    return out.take();
}

std::string writeGlobalProfile(const proto::GlobalProfile& profile) {
    Writer out;
    out.open("GlobalProfile");
    out.count("count", profile.services_size());
    out.content();
    for (const auto& service : profile.services()) {
        out.open("Service");
        out.attribute("name", service.name());
        out.text("descr", service.descr());
        if (service.on_failure() == proto::HOLD_OTHERS) out.attribute("on_failure", "hold-others");
        if (service.on_failure() == proto::COMPENSATE) out.attribute("on_failure", "compensate");
        out.content();
        for (const auto& step : service.steps()) {
            out.open("entity");
            out.text("name", step.name());
            out.attribute("category", proto::Category_Name(step.category()));
            out.attribute("type", proto::Mobility_Name(step.type()));
            out.count("id", step.role());
            out.attribute("service_global_id", step.service_global_id());
            out.count("preced", step.preced());
            writeKeyValues(out, step, "entity");
        }
        for (const auto& step : service.compensation()) {
            out.open("compensate");
            out.count("id", step.role());
            out.attribute("service_global_id", step.service_global_id());
            writeKeyValues(out, step, "compensate");
        }
        out.close("Service");
    }
    out.close("GlobalProfile");
    return out.take();
}

}  // namespace axon

// SPDX-License-Identifier: GPL-2.0-or-later
#include "axon/testing/script.hpp"

#include <algorithm>
#include <utility>

#include "axon/testing/failure.hpp"

namespace axon::testing {

namespace {
template <class T>
const T* valueOf(const Request& request, const std::string& parameter) {
    const auto found = request.parameters.find(parameter);
    if (found == request.parameters.end() || found->second.empty()) return nullptr;
    return std::get_if<T>(&found->second.front());
}

[[noreturn]] void missing(const Request& request, const std::string& parameter, const char* type) {
    throw Failure(Failure::Kind::Otherwise,
                  std::string("a ") + type + " '" + parameter + "' of the task '" + request.service + "'",
                  request.has(parameter) ? "it has another type" : "it was not given");
}
}  // namespace

double Request::number(const std::string& parameter) const {
    if (const auto* number = valueOf<double>(*this, parameter)) return *number;
    if (const auto* whole = valueOf<std::int64_t>(*this, parameter)) return static_cast<double>(*whole);
    missing(*this, parameter, "number");
}
std::string Request::text(const std::string& parameter) const {
    if (const auto* text = valueOf<std::string>(*this, parameter)) return *text;
    missing(*this, parameter, "text");
}

Script& Script::add(Step step) {
    step.after = std::exchange(pause_, client::Seconds{0});
    steps_.push_back(std::move(step));
    return *this;
}
Script& Script::after(client::Seconds time) {
    pause_ += std::max(time, client::Seconds{0});
    return *this;
}
Script& Script::progress(double part) {
    return add({.kind = Step::Kind::Progress, .numbers = {part}});
}
Script& Script::feedback(std::string text) {
    return add({.kind = Step::Kind::Feedback, .text = std::move(text)});
}
Script& Script::result(std::string name, std::vector<client::Value> values) {
    return add({.kind = Step::Kind::Result, .text = std::move(name), .values = std::move(values)});
}
Script& Script::sample(std::string stream, std::vector<double> numbers, std::string units) {
    return add({.kind = Step::Kind::Sample,
                .text = std::move(stream),
                .units = std::move(units),
                .numbers = std::move(numbers)});
}
Script& Script::succeed() {
    return add({.kind = Step::Kind::Succeed});
}
Script& Script::fail(std::string reason) {
    return add({.kind = Step::Kind::Fail, .text = std::move(reason)});
}
Script& Script::robotLost(std::string reason) {
    return add({.kind = Step::Kind::RobotLost, .text = std::move(reason)});
}
Script& Script::never() {
    return add({.kind = Step::Kind::Never});
}
Script Script::denied(std::string reason) {
    Script script;
    script.denied_ = true;
    script.reason_ = std::move(reason);
    return script;
}

}  // namespace axon::testing

// SPDX-License-Identifier: MIT
#include "messages/composites.hpp"

#include <algorithm>
#include <map>
#include <set>
#include <string_view>
#include <utility>

#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon {

bool isSettable(const proto::CtrlParam& meta) {
    return meta.type() == proto::INPUT || meta.type() == proto::CONFIG;
}

std::string viewName(const proto::ServicesProfile& profile, int service, const std::string& name) {
    return profile.services(service).name() + '.' + name;
}

namespace {

std::size_t at(int position) {
    return static_cast<std::size_t>(position);
}

class CompositesReader {
  public:
    explicit CompositesReader(const proto::ServicesProfile& profile)
        : profile_(profile),
          count_(at(profile.services_size())),
          own_(count_),
          sizes_(count_),
          levels_(count_) {
        out_.parts.resize(count_);
        out_.params.resize(count_);
        out_.resources.resize(count_);
    }

    Composites read() {
        findReferences();
        for (const auto service : partsFirst()) readService(service);
        for (const auto service : composites_) {
            showParts(service);
            checkOwn(service);
        }
        return std::move(out_);
    }

  private:
    const proto::Service& service(int position) const { return profile_.services(position); }
    bool composite(int position) const { return service(position).type() == proto::CMPLX; }
    void fault(int position, std::string expected, std::string fix, bool error = true) {
        out_.faults.push_back({position, error, std::move(expected), std::move(fix)});
    }

    void findReferences() {
        std::map<std::string_view, int> positions;
        for (int i = 0; i < profile_.services_size(); ++i)
            if (!service(i).name().empty()) positions.emplace(service(i).name(), i);
        for (int i = 0; i < profile_.services_size(); ++i)
            if (!service(i).global_id().empty()) positions.emplace(service(i).global_id(), i);
        references_.resize(count_);
        for (int i = 0; i < profile_.services_size(); ++i) {
            if (!composite(i)) continue;
            for (const auto& name : service(i).service_list())
                if (const auto target = positions.find(name); target != positions.end())
                    references_[at(i)].push_back(target->second);
            for (int param = 0; param < service(i).params_size(); ++param)
                if (isSettable(service(i).params(param)))
                    own_[at(i)].emplace(service(i).params(param).name(), param);
        }
    }

    /// Every service after those it lists.
    std::vector<int> partsFirst() {
        enum class Mark { Fresh, Open, Done };
        std::vector<Mark> marks(count_, Mark::Fresh);
        std::vector<int> order;
        for (int start = 0; start < profile_.services_size(); ++start) {
            if (marks[at(start)] != Mark::Fresh) continue;
            std::vector<std::pair<int, std::size_t>> stack{{start, 0}};
            marks[at(start)] = Mark::Open;
            while (!stack.empty()) {
                auto& [position, next] = stack.back();
                if (next == references_[at(position)].size()) {
                    marks[at(position)] = Mark::Done;
                    order.push_back(position);
                    stack.pop_back();
                    continue;
                }
                const auto target = references_[at(position)][next++];
                if (marks[at(target)] != Mark::Fresh) continue;
                marks[at(target)] = Mark::Open;
                stack.emplace_back(target, 0);
            }
        }
        return order;
    }

    /// Counts before it copies, so that a small profile cannot ask for a large memory.
    void readService(int position) {
        auto& parts = out_.parts[at(position)];
        if (!composite(position)) {
            sizes_[at(position)] = 1;
            parts.push_back({position});
            return;
        }
        std::size_t size = 0;
        int level = 0;
        for (const auto target : references_[at(position)]) {
            if (sizes_[at(target)] == 0) return;  // a circle, or too large by itself, which has been reported
            size += sizes_[at(target)];
            level = std::max(level, levels_[at(target)]);
        }
        ++level;
        if (size > Composites::kParts) {
            fault(position,
                  "at most " + std::to_string(Composites::kParts) + " parts, found " + std::to_string(size),
                  "take some out of its list");
            return;
        }
        if (level > Composites::kLevels) {
            fault(position,
                  "at most " + std::to_string(Composites::kLevels) + " composites one within the other",
                  "list the services themselves");
            return;
        }
        if (together_ + size > Composites::kPartsTogether) {
            fault(
                position,
                "at most " + std::to_string(Composites::kPartsTogether) + " parts in all composites together",
                "take some composites out");
            return;
        }
        together_ += size;
        sizes_[at(position)] = std::max<std::size_t>(size, 1);
        levels_[at(position)] = level;
        for (const auto target : references_[at(position)])
            for (const auto& part : out_.parts[at(target)]) {
                auto& way = parts.emplace_back(Composites::Part{position});
                way.insert(way.end(), part.begin(), part.end());
            }
        composites_.push_back(position);
    }

    void showParts(int position) {
        // A parameter and a resource may have one name, as they may in the part itself.
        std::set<std::string> param_names, resource_names;
        for (const auto& param : service(position).params()) param_names.insert(param.name());
        for (const auto& resource : service(position).resources()) resource_names.insert(resource.name());
        std::set<std::pair<int, int>> params, resources;
        std::set<Composites::Part> seen;
        const auto show = [&](std::vector<Composites::View>& views, std::set<std::string>& names, int from,
                              int item, const std::string& name, std::size_t bytes) {
            views.push_back({from, item});
            auto shown = viewName(profile_, from, name);
            shown_bytes_ += bytes + shown.size();
            if (names.insert(shown).second) return;
            fault(position,
                  "names that differ from those of its parts' parameters and resources; " + inQuotes(shown) +
                      " would mean two things",
                  "rename one of them");
        };
        for (const auto& part : out_.parts[at(position)]) {
            if (!seen.insert(part).second) continue;
            for (std::size_t level = 1; level < part.size(); ++level) {
                const auto from = part[level];
                const bool simple = level + 1 == part.size();
                for (int i = 0; i < service(from).params_size(); ++i) {
                    const auto& param = service(from).params(i);
                    const bool visible = isSettable(param) ? !isFed(part, level, param.name()) : simple;
                    if (visible && params.emplace(from, i).second)
                        show(out_.params[at(position)], param_names, from, i, param.name(),
                             param.ByteSizeLong());
                }
                for (int i = 0; i < service(from).resources_size(); ++i)
                    if (const auto& resource = service(from).resources(i); resources.emplace(from, i).second)
                        show(out_.resources[at(position)], resource_names, from, i, resource.name(),
                             resource.ByteSizeLong());
            }
        }
        if (shown_bytes_ <= Composites::kShownBytes || too_much_shown_) return;
        too_much_shown_ = true;
        fault(position, "parameters of parts that come to at most 1 MiB in all composites together",
              "take some composites out, or shorten descriptions and choices");
    }

    bool isFed(const Composites::Part& part, std::size_t level, const std::string& name) const {
        return std::any_of(part.begin(), part.begin() + static_cast<std::ptrdiff_t>(level),
                           [&](int around) { return own_[at(around)].contains(name); });
    }

    /// What a composite declares itself is the value of its parts' parameters of that name: it must suit
    /// them.
    void checkOwn(int position) {
        std::set<std::string_view> used;
        std::set<std::pair<int, int>> checked;
        for (const auto& part : out_.parts[at(position)])
            for (std::size_t level = 1; level < part.size(); ++level)
                for (int i = 0; i < service(part[level]).params_size(); ++i) {
                    const auto& theirs = service(part[level]).params(i);
                    const auto own = own_[at(position)].find(theirs.name());
                    if (own == own_[at(position)].end() || !isSettable(theirs)) continue;
                    used.insert(own->first);
                    if (checked.emplace(part[level], i).second)
                        checkPair(position, service(position).params(own->second), part[level], theirs);
                }
        if (out_.parts[at(position)].empty()) return;
        for (const auto& [name, param] : own_[at(position)])
            if (!used.contains(name))
                fault(position,
                      "a part with an INPUT or CONFIG parameter " + inQuotes(name) +
                          "; without one the composite's own has no effect",
                      "name it like the parameter of the part, or leave it out", false);
    }
    void checkPair(int position, const proto::CtrlParam& own, int part, const proto::CtrlParam& theirs) {
        const auto of = "parameter " + inQuotes(own.name()) + " as its part " +
                        inQuotes(service(part).name()) + " declares it";
        if (own.data_type() != theirs.data_type() || own.units() != theirs.units() ||
            own.multiple() != theirs.multiple()) {
            fault(position, of + ": the same data_type, units and multiple", "make the two agree");
            return;
        }
        if (own.initial_size() == 0) return;
        proto::Param value;
        value.set_name(theirs.name());
        *value.mutable_values() = own.initial();
        if (const auto refusal = checkParam(theirs, value); !refusal.ok())
            fault(position, of + ": " + refusal.message, "give it a value that the part accepts");
    }

    const proto::ServicesProfile& profile_;
    const std::size_t count_;
    std::vector<std::vector<int>> references_;
    std::vector<std::map<std::string_view, int>>
        own_;                         ///< what a composite declares itself and a client may set
    std::vector<std::size_t> sizes_;  ///< 0 = has no parts that could be counted
    std::vector<int> levels_;
    std::vector<int> composites_;  ///< without a fault, parts first
    std::size_t together_ = 0, shown_bytes_ = 0;
    bool too_much_shown_ = false;
    Composites out_;
};

}  // namespace

Composites readComposites(const proto::ServicesProfile& profile) {
    return CompositesReader(profile).read();
}

}  // namespace axon

// SPDX-License-Identifier: GPL-2.0-or-later
#include "global_services/services_folder.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <cstdint>
#include <map>
#include <system_error>
#include <utility>
#include <vector>

#include "common/snapshot.hpp"
#include "common/utf8.hpp"
#include "host/file_mark.hpp"
#include "messages/profile_reader.hpp"
#include "messages/text.hpp"
#include "messages/xml_document.hpp"

namespace axon::global_services {
namespace {

constexpr std::size_t kRequestIdBytesMax = 64;
constexpr std::size_t kFindingsServed = 100;  // of each file
constexpr std::size_t kFindingsSaid = 20;     // of each file, in the log
constexpr std::size_t kNamesSaid = 10;

/// Found out only when it is wanted: the profile itself does not know its lines.
std::vector<int> linesOfServices(std::string_view xml) {
    std::vector<int> lines;
    const auto document = parseXml(xml);
    if (!document.root) return lines;
    for (const auto& child : document.root->children)
        if (child.name == "Service") lines.push_back(child.line);
    return lines;
}

std::string counted(std::size_t number, const char* one) {
    return std::to_string(number) + " " + one + (number == 1 ? "" : "s");
}

Finding errorIn(const std::string& name, int line, std::string element, std::string expected,
                std::string fix) {
    return {validUtf8(name),     line,          Finding::Severity::Error, std::move(element),
            std::move(expected), std::move(fix)};
}

proto::GlobalServicesFile entryOf(const std::string& name, const proto::GlobalProfile& profile,
                                  const std::vector<Finding>& findings) {
    proto::GlobalServicesFile file;
    file.set_name(validUtf8(name));
    file.set_bad(hasError(findings));
    if (!file.bad()) *file.mutable_profile() = profile;
    for (std::size_t i = 0; i < std::min(findings.size(), kFindingsServed); ++i)
        file.add_findings(validUtf8(findings[i].toString()));
    if (findings.size() > kFindingsServed)
        file.add_findings(file.name() + ": " + counted(findings.size() - kFindingsServed, "finding") +
                          " more; axon profile check lists them all");
    return file;
}

}  // namespace

class ServicesFolder::Contents {
  public:
    /// As an absolute path, which tells people where to look.
    Contents(const std::filesystem::path& folder, std::error_code failure, Note note)
        : folder_(std::filesystem::absolute(folder, failure)), note_(std::move(note)) {}

    void look();
    std::shared_ptr<const proto::GlobalServices> services() const { return services_.load(); }

  private:
    struct File {
        FileMark mark;
        bool settled = false;  ///< read again after a look at which nothing had changed
        proto::GlobalProfile profile;
        std::vector<Finding> findings;
        std::vector<int> lines;  ///< of each service of the profile
    };

    std::map<std::string, FileMark> list();
    File read(const std::string& name, const FileMark& mark) const;
    void publish();
    void say(const proto::GlobalServicesFile& file) const;

    const std::filesystem::path folder_;
    const Note note_;
    Snapshot<proto::GlobalServices> services_;

    // Confined to the thread that looks:
    std::map<std::string, File> files_;        // by name
    std::map<std::string, std::string> said_;  // by name: what was published of it
    std::size_t left_out_ = 0;                 // files beyond the bound
    std::string trouble_;                      // why the folder cannot be read
    bool there_ = false;                       // it has been read: many servers never have one
};

std::map<std::string, FileMark> ServicesFolder::Contents::list() {
    std::map<std::string, FileMark> found;
    std::error_code failure;
    std::string trouble;
    for (std::filesystem::directory_iterator entry(folder_, failure), end; !failure && entry != end;
         entry.increment(failure)) {
        const auto name = entry->path().filename().string();
        if (name.starts_with('.') || entry->path().extension() != ".xml") continue;
        if (const auto mark = FileMark::of(entry->path().c_str())) found[name] = *mark;
    }
    if (failure == std::errc::no_such_file_or_directory) {
        if (there_) trouble = folder_.string() + " is gone; no global services are offered";
    } else if (failure) {
        trouble =
            folder_.string() + " cannot be read (" + failure.message() + "); no global services are offered";
    } else {
        there_ = true;
    }
    if (std::exchange(trouble_, trouble) != trouble && !trouble.empty()) note_("global services: " + trouble);
    return found;
}

void ServicesFolder::Contents::look() {
    auto found = list();
    std::size_t left_out = 0;
    for (; found.size() > kFilesMax; ++left_out) found.erase(std::prev(found.end()));

    const auto gone = std::erase_if(files_, [&](const auto& file) { return !found.contains(file.first); });
    bool news = gone > 0 || std::exchange(left_out_, left_out) != left_out;
    for (const auto& [name, mark] : found) {
        auto& known = files_[name];  // a new one's mark is that of no file
        const bool same = known.mark == mark;
        if (same && known.settled) continue;
        known = read(name, mark);
        known.settled = same;
        news = true;
    }
    if (news) publish();
}

ServicesFolder::Contents::File ServicesFolder::Contents::read(const std::string& name,
                                                              const FileMark& mark) const {
    File file;
    file.mark = mark;
    const auto text = readProfileText(folder_ / name, validUtf8(name));
    if (text.unreadable) {
        file.findings.push_back(*text.unreadable);
        return file;
    }
    auto reading = readGlobalProfile(text.xml, validUtf8(name));
    file.findings = std::move(reading.findings);
    if (hasError(file.findings)) return file;
    file.profile = std::move(reading.message);
    file.lines = linesOfServices(text.xml);
    file.lines.resize(static_cast<std::size_t>(file.profile.services_size()));
    return file;
}

void ServicesFolder::Contents::publish() {
    auto services = std::make_shared<proto::GlobalServices>();
    std::map<std::string, std::string> owners;  // of a service's name: file and line
    std::size_t bytes = 0;
    for (const auto& [name, file] : files_) {
        auto findings = file.findings;
        for (std::size_t i = 0; i < file.lines.size(); ++i) {
            const auto& service = file.profile.services(static_cast<int>(i)).name();
            if (const auto owner = owners.find(service); owner != owners.end())
                findings.push_back(
                    errorIn(name, file.lines[i], "Service " + inQuotes(service) + " name",
                            "a service name that no other file has; it is also in " + owner->second,
                            "rename one of the two, or remove one of the files"));
        }
        std::stable_sort(findings.begin(), findings.end(),
                         [](const Finding& a, const Finding& b) { return a.line < b.line; });
        auto entry = entryOf(name, file.profile, findings);
        if (bytes + entry.ByteSizeLong() > kAnswerBytesMax)
            entry =
                entryOf(name, {},
                        {errorIn(name, 0, "file",
                                 "at most " + std::to_string(kAnswerBytesMax / 1024) +
                                     " KiB of global services in all files of the folder; this one is beyond",
                                 "remove services that nobody uses")});
        if (!entry.bad()) {
            for (std::size_t i = 0; i < file.lines.size(); ++i)
                owners.emplace(file.profile.services(static_cast<int>(i)).name(),
                               validUtf8(name) + ", line " + std::to_string(file.lines[i]));
        }
        bytes += entry.ByteSizeLong();
        *services->add_files() = std::move(entry);
    }
    if (left_out_ > 0) {
        const std::string name = folder_.filename().empty() ? folder_.string() : folder_.filename().string();
        *services->add_files() =
            entryOf(name, {},
                    {errorIn(name, 0, "folder",
                             "at most " + std::to_string(kFilesMax) + " files; " + std::to_string(left_out_) +
                                 " more files, the last by name, are not read",
                             "put several services into one file")});
    }

    std::map<std::string, std::string> said;
    for (const auto& file : services->files()) {
        const auto text = file.SerializeAsString();
        const auto before = said_.find(file.name());
        if (before == said_.end() || before->second != text) say(file);
        said.emplace(file.name(), text);
    }
    for (const auto& [name, text] : said_)
        if (!said.contains(name)) note_("global services: " + name + " is gone");
    if (said == said_) return;
    said_ = std::move(said);
    services_.store(std::move(services));
}

void ServicesFolder::Contents::say(const proto::GlobalServicesFile& file) const {
    std::string names;
    for (int i = 0; i < std::min(file.profile().services_size(), static_cast<int>(kNamesSaid)); ++i)
        names += (i == 0 ? " " : ", ") + inQuotes(file.profile().services(i).name());
    if (file.profile().services_size() > static_cast<int>(kNamesSaid)) names += ", …";
    note_("global services: " + file.name() +
          (file.bad()
               ? std::string(" has errors, so its services are not offered")
               : " offers " + counted(static_cast<std::size_t>(file.profile().services_size()), "service") +
                     (names.empty() ? "" : ":" + names)));
    for (int i = 0; i < std::min(file.findings_size(), static_cast<int>(kFindingsSaid)); ++i)
        note_("global services: " + file.findings(i));
    if (file.findings_size() > static_cast<int>(kFindingsSaid))
        note_("global services: " + file.name() + " has more; axon profile check lists them all");
}

ServicesFolder::ServicesFolder(const std::filesystem::path& folder, const Clock& clock, Note note)
    : clock_(clock),
      next_(clock.now() + kPeriod),
      contents_(std::make_unique<Contents>(folder, std::error_code(), std::move(note))) {
    contents_->look();
}

ServicesFolder::~ServicesFolder() = default;

TimePoint ServicesFolder::onTimer() {
    const auto now = clock_.now();
    if (now < next_) return next_;
    next_ = now + kPeriod;
    contents_->look();
    return next_;
}

Result<std::string> ServicesFolder::answer(std::string_view request) {
    proto::ToEntity message;
    if (!message.ParseFromArray(request.data(), static_cast<int>(request.size())) ||
        !message.has_global_services())
        return Refusal{RefusalCode::Malformed, "expected an axon.proto.ToEntity with global_services", {}};
    const auto& id = message.global_services().request_id();
    if (id.size() > kRequestIdBytesMax)
        return Refusal{RefusalCode::Malformed,
                       "expected a request_id of at most " + std::to_string(kRequestIdBytesMax) + " bytes",
                       {}};
    proto::ToClient reply;
    const auto services = contents_->services();
    *reply.mutable_global_services() = *services;
    reply.mutable_global_services()->set_request_id(id);
    return reply.SerializeAsString();
}

}  // namespace axon::global_services

// SPDX-License-Identifier: GPL-2.0-or-later
#include "certificates/folder.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <set>
#include <sstream>
#include <system_error>
#include <utility>

#include "common/descriptor.hpp"

namespace axon::certificates {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kFileMax = 1024 * 1024;
constexpr const char* kAuthorityFile = "ca.cert.pem";
constexpr const char* kAuthorityKey = "ca.key.pem";
constexpr const char* kCertificateEnd = ".cert.pem";
constexpr const char* kIssuedFile = "issued.txt";
constexpr const char* kListFile = "revoked.crl.pem";

std::string because() {
    return std::generic_category().message(errno);
}

struct NewFile {
    fs::path path;
    std::string content;
    mode_t mode;
};

constexpr std::chrono::days kListLongest{3650};
constexpr const char* kWritable = "name a folder that you may write to: --folder DIR";

/// Under a new name beside its place, which is returned.
fs::path writeAside(const NewFile& file) {
    auto next = file.path.string() + ".XXXXXX";
    const Descriptor fd(::mkostemp(next.data(), O_CLOEXEC));
    bool done = fd.open() && ::fchmod(fd.get(), file.mode) == 0;
    for (std::string_view rest = file.content; done && !rest.empty();) {
        const auto count = ::write(fd.get(), rest.data(), rest.size());
        if (count < 0 && errno == EINTR) continue;
        done = count >= 0;
        if (done) rest.remove_prefix(static_cast<std::size_t>(count));
    }
    if (done && ::fsync(fd.get()) == 0) return next;
    const auto why = because();
    if (fd.open()) ::unlink(next.c_str());
    throw Unusable(file.path.string() + " cannot be written: " + why, kWritable);
}

/// Files that are written whole beside their places, and then replace what is there in one step each. Those
/// that were not placed are deleted.
class Aside {
  public:
    explicit Aside(const std::vector<NewFile>& files) : Aside() {  // so that it is destroyed if one fails
        for (const auto& file : files) next_.emplace_back(writeAside(file), file.path);
    }
    ~Aside() {
        for (const auto& [next, _] : next_) ::unlink(next.c_str());
    }
    Aside(const Aside&) = delete;
    Aside& operator=(const Aside&) = delete;

    void place(bool force) const {
        for (const auto& [next, path] : next_) {
            // A link fails where there is one already; a rename would not.
            const bool placed =
                force ? ::rename(next.c_str(), path.c_str()) == 0 : ::link(next.c_str(), path.c_str()) == 0;
            if (!placed) throw Unusable(path.string() + " cannot be written: " + because(), kWritable);
        }
    }

  private:
    Aside() = default;

    std::vector<std::pair<fs::path, fs::path>> next_;  // aside, and its place
};

void refuseExisting(const std::vector<NewFile>& files, const std::string& meaning) {
    for (const auto& file : files) {
        std::error_code ignored;
        if (fs::exists(fs::symlink_status(file.path, ignored)))
            throw Unusable(file.path.string() + " is there already", meaning);
    }
}

/// Holds the folder for one command at a time; it waits for the others.
class Held {
  public:
    explicit Held(const fs::path& folder) : fd_(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {
        int got = fd_.open() ? ::flock(fd_.get(), LOCK_EX) : -1;
        while (got != 0 && fd_.open() && errno == EINTR) got = ::flock(fd_.get(), LOCK_EX);
        if (got == 0) return;
        const bool missing = errno == ENOENT;
        throw Unusable(folder.string() + " cannot be used: " + because(),
                       missing ? "axon certs init --folder " + folder.string() + " makes one" : kWritable);
    }
    /// The names of new files come to the disk as well, before what follows.
    void sync() const { ::fsync(fd_.get()); }

  private:
    const Descriptor fd_;
};

Unusable tooLong(const fs::path& index) {
    return {
        index.string() + ": expected at most 1 MiB, which is about 14,000 certificates",
        "delete the lines of certificates that have ended; their second word is the end, in seconds since "
        "1970 (date -d @SECONDS)"};
}

/// The certificate in this file, if this CA has signed it.
std::optional<Certificate> ofThisCa(const fs::path& file, const Issued& authority) {
    std::error_code error;
    if (!fs::exists(file, error)) return std::nullopt;
    const auto text = readFile(file, "delete it, and issue the certificate again");
    try {
        checkSignedBy(text, authority.certificate, file.string());
        return readCertificates(text, file.string()).front();
    } catch (const Unusable&) {
        return std::nullopt;
    }
}

/// As Ice's property parser reads it back.
std::string escaped(const std::string& value) {
    std::string text;
    for (const char c : value) {
        if (c == '\\' || c == '#') text += '\\';
        text += c;
    }
    return text;
}

/// One that Ice can read back from a configuration file.
fs::path usable(fs::path path) {
    std::error_code error;
    if (path.empty())
        throw Unusable("neither XDG_CONFIG_HOME nor HOME says where your configuration is",
                       "name the folder: --folder DIR");
    auto whole = fs::absolute(path, error).lexically_normal();
    if (error) throw Unusable(path.string() + ": " + error.message(), "name the folder: --folder DIR");
    const auto text = whole.string();
    if (std::any_of(text.begin(), text.end(), [](unsigned char c) { return c < 0x20 || c == 0x7F; }))
        throw Unusable("expected a folder without line ends and control characters in its name",
                       "name another one: --folder DIR");
    if (!whole.has_filename() && whole.has_parent_path() && whole != whole.root_path())
        whole = whole.parent_path();
    return whole;
}

}  // namespace

std::string readFile(const fs::path& file, const std::string& fix) {
    const Descriptor fd(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    if (fd.get() < 0) throw Unusable(file.string() + " cannot be read: " + because(), fix);
    struct stat facts {};
    if (::fstat(fd.get(), &facts) != 0 || !S_ISREG(facts.st_mode))
        throw Unusable(file.string() + ": expected a regular file", fix);
    std::string text;
    std::array<char, 4096> buffer;
    while (true) {
        const auto got = ::read(fd.get(), buffer.data(), buffer.size());
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) throw Unusable(file.string() + " cannot be read: " + because(), fix);
        if (got == 0) return text;
        text.append(buffer.data(), static_cast<std::size_t>(got));
        if (text.size() > kFileMax) throw Unusable(file.string() + ": expected at most 1 MiB", fix);
    }
}

Folder::Folder(fs::path path) : path_(usable(std::move(path))) {}

Written Folder::init(WallTime now, bool force) const {
    std::error_code error;
    if (!fs::exists(path_, error)) {
        fs::create_directories(path_.parent_path(), error);
        if (::mkdir(path_.c_str(), 0700) != 0 && errno != EEXIST)
            throw Unusable(path_.string() + " cannot be made: " + because(), kWritable);
    } else if (!fs::is_directory(path_, error)) {
        throw Unusable(path_.string() + " is no folder", kWritable);
    }
    const Held held(path_);
    const auto made = makeAuthority(now);
    const std::vector<NewFile> files{{path_ / kAuthorityKey, made.key, 0600},
                                     {path_ / kAuthorityFile, made.certificate, 0644}};
    if (!force)
        refuseExisting(files,
                       "use the CA that is there (axon certs issue), or make another folder (--folder DIR); "
                       "--force makes a new CA, and every certificate of the old one becomes void");
    const Aside aside(files);
    // They are about certificates of the old CA. A new CA with an old list could revoke nothing.
    for (const auto* file : {kIssuedFile, kListFile})
        if (::unlink((path_ / file).c_str()) != 0 && errno != ENOENT)
            throw Unusable((path_ / file).string() + " cannot be deleted: " + because(), kWritable);
    held.sync();
    aside.place(force);
    held.sync();
    return {{files[1].path, files[0].path}, readCertificates(made.certificate, kAuthorityFile).front()};
}

Written Folder::issue(const Request& request, WallTime now, bool force) const {
    check(request);
    const Held held(path_);
    const auto its_authority = authority();
    const auto issued = certificates::issue(its_authority, request, now);
    const auto stem = fileStem(request);
    const std::vector<NewFile> files{{path_ / (stem + ".key.pem"), issued.key, 0600},
                                     {path_ / (stem + kCertificateEnd), issued.certificate, 0644},
                                     {path_ / (stem + ".cfg"), configuration(request, stem, path_), 0644}};
    const auto its = readCertificates(issued.certificate, stem).front();
    if (!force)
        refuseExisting(files,
                       "--force replaces it; the certificate that is there stays valid wherever it is used");
    auto all = issuedSoFar();
    const auto note = [&](const Certificate& one) {
        const auto same = [&](const Entry& known) { return known.serial == one.serial; };
        if (std::none_of(all.begin(), all.end(), same)) all.push_back({one.serial, one.until, stem});
    };
    // One that the index does not know, such as a copy from elsewhere, can be revoked by its name as well.
    if (const auto replaced = ofThisCa(files[1].path, its_authority)) note(*replaced);
    note(its);
    std::string index;
    for (const auto& one : all)
        index +=
            one.serial + " " + std::to_string(one.until.time_since_epoch().count()) + " " + one.stem + "\n";
    if (index.size() > kFileMax) throw tooLong(path_ / kIssuedFile);
    const Aside aside(files);
    // First, so that no certificate is in place that could not be revoked by its name.
    Aside({{path_ / kIssuedFile, index, 0644}}).place(true);
    held.sync();
    aside.place(force);
    held.sync();
    return {{files[1].path, files[0].path, files[2].path}, its};
}

Issued Folder::authority() const {
    const auto folder = " --folder " + path_.string();
    std::error_code error;
    const bool missing = !fs::exists(path_ / kAuthorityFile, error) && !error;
    const std::string fix = missing ? "axon certs init" + folder + " makes one"
                                    : "run this as the user who made the CA, or name another folder";
    return {readFile(path_ / kAuthorityFile, fix), readFile(path_ / kAuthorityKey, fix)};
}

std::vector<Folder::Entry> Folder::issuedSoFar() const {
    std::error_code error;
    const auto file = path_ / kIssuedFile;
    std::vector<Entry> all;
    if (!fs::exists(file, error) && !error) return all;
    if (const auto size = fs::file_size(file, error); !error && size > kFileMax) throw tooLong(file);
    std::istringstream lines(readFile(file, "run this as the user who made the CA"));
    for (std::string line; std::getline(lines, line);) {
        std::istringstream words(line);
        Entry one;
        std::int64_t until = 0;
        words >> one.serial >> until >> one.stem;
        if (!words || one.serial.size() % 2 != 0 ||
            one.serial.find_first_not_of("0123456789abcdef") != std::string::npos)
            throw Unusable(file.string() + ": '" + line + "' is no line of a certificate that was issued",
                           "restore the file from a copy, or delete it: then only certificates whose files "
                           "are there can be revoked");
        one.until = WallTime(std::chrono::seconds{until});
        all.push_back(std::move(one));
    }
    return all;
}

std::optional<RevocationList> Folder::revocationList() const {
    std::error_code error;
    const auto file = path_ / kListFile;
    if (!fs::exists(file, error) && !error) return std::nullopt;
    const std::string fix = "run this as the user who made the CA, or name another folder";
    return readRevocationList(readFile(file, fix), readFile(path_ / kAuthorityFile, fix), file.string());
}

Revoked Folder::revoke(const std::vector<std::string>& names, std::optional<std::chrono::days> valid,
                       WallTime now) const {
    const Held held(path_);
    const auto its_authority = authority();
    if (valid && (*valid < std::chrono::days{1} || *valid > kListLongest))
        throw Unusable("expected a validity of 1 to " + std::to_string(kListLongest.count()) + " days",
                       "leave --days out, and the list is valid as long as the CA");
    const auto previous = revocationList().value_or(RevocationList{});
    auto serials = previous.serials;
    const auto isFile = [](const std::string& name) {
        return name.find('/') != std::string::npos || name.ends_with(".pem");
    };
    const auto issued =
        std::all_of(names.begin(), names.end(), isFile) ? std::vector<Entry>{} : issuedSoFar();
    for (const auto& name : names) {
        std::set<std::string> its;
        const bool is_file = isFile(name);
        const auto file = is_file ? fs::path(name) : path_ / (name + kCertificateEnd);
        std::error_code error;
        if (is_file || fs::exists(file, error)) {
            const auto text = readFile(file, "name a file that you may read");
            const auto one = readCertificates(text, file.string()).front();
            if (one.authority)
                throw Unusable(file.string() + " is the certificate of a CA",
                               "axon certs init --force makes a new CA, and every certificate of the old one "
                               "becomes void");
            checkSignedBy(text, its_authority.certificate, file.string());
            if (is_file || one.until > now) its.insert(one.serial);
        }
        if (!is_file)
            for (const auto& one : issued)
                if (one.stem == name && one.until > now) its.insert(one.serial);
        if (its.empty())
            throw Unusable("no certificate that is still valid was issued as '" + name + "'",
                           "name one as axon certs show does, without .cert.pem, such as client-client1, or "
                           "the file of a certificate");
        const auto known = serials.size();
        for (const auto& serial : its) serials.emplace(serial, now);
        if (serials.size() == known)
            throw Unusable("'" + name + "' is revoked already", "if a server still accepts it: copy " +
                                                                    (path_ / kListFile).string() +
                                                                    " to that server, and restart it");
    }
    // Whoever compares lists takes that with the greater number, also after a clock was set back.
    const auto number =
        std::max(previous.number + 1, static_cast<std::uint64_t>(now.time_since_epoch().count()));
    const auto list = makeRevocationList(its_authority, serials, number, valid, now);
    Aside({{path_ / kListFile, list, 0644}}).place(true);
    held.sync();
    return {path_ / kListFile, readRevocationList(list, its_authority.certificate, kListFile).until,
            serials.size() - previous.serials.size(), serials.size()};
}

std::vector<fs::path> Folder::certificateFiles() const {
    std::error_code error;
    std::vector<fs::path> files;
    for (fs::directory_iterator at(path_, error), end; !error && at != end; at.increment(error)) {
        const auto name = at->path().filename().string();
        const auto length = std::strlen(kCertificateEnd);
        if (name.size() > length && name.compare(name.size() - length, length, kCertificateEnd) == 0)
            files.push_back(at->path());
    }
    if (error)
        throw Unusable(
            path_.string() + " cannot be read: " + error.message(),
            "axon certs init --folder " + path_.string() + " makes one, or name the folder of another CA");
    std::sort(files.begin(), files.end());
    std::stable_partition(files.begin(), files.end(),
                          [](const fs::path& file) { return file.filename() == kAuthorityFile; });
    return files;
}

std::vector<Certificate> readCertificateFile(const fs::path& file) {
    return readCertificates(readFile(file, "name a file that you may read"), file.string());
}

std::string fileStem(const Request& request) {
    auto name = std::string(toString(request.kind)) + "-" + request.names.front();
    for (auto& c : name) {
        const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                           c == '.' || c == '-' || c == '_';
        if (!plain) c = '_';
    }
    return name;
}

std::string configuration(const Request& request, const std::string& stem, const fs::path& folder) {
    const auto name = request.names.front();
    std::string text;
    switch (request.kind) {
        case Kind::Client:
            text = "# The certificate of the user " + name +
                   ": axon --config FILE, or AXON_CONFIG=FILE.\n"
                   "#Axon.Server=ssl://HOST:10410\n";
            break;
        case Kind::Entity:
            text = "# The certificate of the entity " + name +
                   ": axon-entity-manager --config FILE, with\n"
                   "# what its Entity Manager needs besides (docs/reference/configuration.md).\n"
                   "#Axon.Application=\n"
                   "#Axon.Server=ssl://HOST:10412\n";
            break;
        case Kind::Server:
            text = "# The certificate of the server " + name +
                   ": axon-server --config FILE --config …\n"
                   "#FrontEndServer.Endpoints=ssl -h 0.0.0.0 -p 10410\n"
                   "#FrontEndServerSignal.Endpoints=ssl -h 0.0.0.0 -p 10411\n"
                   "#EntityServer.Endpoints=ssl -h 0.0.0.0 -p 10412\n"
                   "#EntityServerSignal.Endpoints=ssl -h 0.0.0.0 -p 10413\n"
                   "#Server.Users=users.cfg\n";
            break;
        case Kind::FrontEnd:
            text = "# The certificate of the front-end server " + name +
                   ": axon-server --role front-end --config FILE --config …\n"
                   "# It is for clients, routers, the other servers and IceStorm.\n"
                   "#Server.Name=" +
                   name +
                   "\n"
                   "#Server.TopicManager=IceStorm/TopicManager:ssl -h HOST -p 10430\n"
                   "#FrontEndServer.Endpoints=ssl -h 0.0.0.0 -p 10410\n"
                   "#FrontEndServerSignal.Endpoints=ssl -h 0.0.0.0 -p 10411\n"
                   "#FrontEndServerTopic.Endpoints=ssl -h HOST -p 10425\n"
                   "#FrontEndServerTopicSignal.Endpoints=ssl -h HOST -p 10426\n"
                   "#Server.Users=users.cfg\n";
            break;
        case Kind::EntityServer:
            text = "# The certificate of the entity server " + name +
                   ": axon-server --role entity --config FILE --config …\n"
                   "# It is for Entity Managers, routers, the other servers and IceStorm.\n"
                   "#Server.Name=" +
                   name +
                   "\n"
                   "#Server.TopicManager=IceStorm/TopicManager:ssl -h HOST -p 10430\n"
                   "#EntityServer.Endpoints=ssl -h 0.0.0.0 -p 10412\n"
                   "#EntityServerSignal.Endpoints=ssl -h 0.0.0.0 -p 10413\n"
                   "#EntityServerTopic.Endpoints=ssl -h HOST -p 10427\n"
                   "#EntityServerTopicSignal.Endpoints=ssl -h HOST -p 10428\n"
                   "#Server.Users=users.cfg\n";
            break;
        case Kind::Storm:
            text = "# The certificate of IceStorm " + name +
                   ": in the file of the service that icebox loads (icestorm.cfg).\n"
                   "#IceStorm.TopicManager.Endpoints=ssl -h HOST -p 10430\n"
                   "#IceStorm.Publish.Endpoints=ssl -h HOST -p 10431\n"
                   "# Only servers may publish and subscribe, and only to servers anything is delivered:\n"
                   "IceSSL.TrustOnly.Server=OU=front-end,O=Axon;OU=entity-server,O=Axon\n"
                   "IceSSL.TrustOnly.Client=OU=front-end,O=Axon;OU=entity-server,O=Axon\n";
            break;
        case Kind::Registry:
            text = "# The certificate of IceGrid on " + name +
                   ": icegridregistry, icegridnode and icegridadmin --Ice.Config=FILE,…\n"
                   "#Ice.Default.Locator=AxonGrid/Locator:ssl -h HOST -p 10426\n"
                   "# A node starts whatever a registry tells it, so they speak to each other only:\n"
                   "IceSSL.TrustOnly=OU=registry,O=Axon\n";
            break;
        case Kind::Router:
            text = "# The certificate of the router " + name +
                   ": glacier2router --Ice.Config=FILE,…\n"
                   "# Only servers are called, and only servers send messages for those who connect.\n"
                   "# If there are several servers, keep in both lines only the kind of those behind this "
                   "router:\n"
                   "# front-end for one of clients, entity-server for one of Entity Managers.\n"
                   "IceSSL.TrustOnly.Client=OU=server,O=Axon;OU=front-end,O=Axon;OU=entity-server,O=Axon\n"
                   "IceSSL.TrustOnly.Server.Glacier2.Server=OU=server,O=Axon;OU=front-end,O=Axon;"
                   "OU=entity-server,O=Axon\n";
            break;
    }
    text +=
        "# On another machine: this file, the three files named below, and their folder there.\n"
        "Ice.Plugin.IceSSL=IceSSL:createIceSSL\n"
        "IceSSL.DefaultDir=" +
        escaped(folder.string()) +
        "\n"
        "IceSSL.CAs=" +
        kAuthorityFile +
        "\n"
        "IceSSL.CertFile=" +
        stem + kCertificateEnd +
        "\n"
        "IceSSL.KeyFile=" +
        stem + ".key.pem\n" +
        (isCalled(request.kind) ? "# After axon certs revoke, with its list beside the other files:\n"
                                  "#IceSSL.RevocationCheck=1\n"
                                  "#IceSSL.CertificateRevocationListFiles=revoked.crl.pem\n"
                                : "") +
        "# Both sides show a certificate of this CA, and a server's must be for the name it was called by.\n"
        "IceSSL.VerifyPeer=2\n"
        "IceSSL.CheckCertName=1\n"
        "IceSSL.Protocols=TLS1_3\n";
    return text;
}

fs::path defaultFolder() {
    const auto from = [](const char* name) {
        const char* value = std::getenv(name);
        return value != nullptr && *value != '\0' ? fs::path(value) : fs::path();
    };
    if (const auto config = from("XDG_CONFIG_HOME"); !config.empty()) return config / "axon" / "certs";
    if (const auto home = from("HOME"); !home.empty()) return home / ".config" / "axon" / "certs";
    return {};
}

}  // namespace axon::certificates

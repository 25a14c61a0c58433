// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lab_server.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <future>
#include <list>
#include <map>
#include <stdexcept>

#include "lab/camera.hpp"
#include "lab/clock_file.hpp"
#include "lab/control.hpp"
#include "lab/pace.hpp"
#include "lab/picture_server.hpp"
#include "lab/sockets.hpp"

namespace axon::lab {
namespace {

constexpr Duration kTick = Pace::kTick;
constexpr Duration kShortestTick = std::chrono::milliseconds{1};   // when time goes fast
constexpr Duration kTruthPeriod = std::chrono::milliseconds{100};  // of the world
// Of the world. Who has other clocks sees it jump back by what is given up; programs on the laboratory's own
// time see nothing, and would be late themselves if it caught up.
constexpr Duration kLongestLag = std::chrono::milliseconds{250};
constexpr Duration kLongestSilentLoss = std::chrono::seconds{1};  // and a tenth of its age
constexpr double kStepRate = 100;  // told while a step is carried out as fast as the physics can
constexpr std::size_t kLongestRequest = 64 * 1024;
constexpr std::size_t kMostControlClients = 16;
constexpr int kMostReads = 64;  // of a client that is heard out
constexpr double kTrackStep_m = 0.05;
constexpr std::size_t kLongestTrack = 20000;

constexpr std::array<std::array<float, 3>, 4> kTrackColours{
    {{1, 0.45F, 0}, {0.1F, 0.5F, 1}, {0.1F, 0.7F, 0.2F}, {0.8F, 0.1F, 0.7F}}};

void complain(std::string_view what) {
    fmt::print(stderr, "axon-lab: {}\n", what);
}

}  // namespace

class LabServer::Loop final : Control::Operator {
  public:
    Loop(WorldDescription world, Options options)
        : options_(std::move(options)),
          world_((complete(world), std::move(world))),
          wake_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)),
          lab_(
              world_, [this](std::size_t robot, const arcos::Bytes& bytes) { send(robots_[robot], bytes); },
              {.seed = options_.seed, .noise = options_.noise}, laserLines()),
          speed_(options_.speed),
          paused_(options_.step),
          stepping_(options_.step),
          pace_(options_.clock_path.empty() ? kLongestLag : Duration::zero()),
          tracks_(world_.robots.size()) {
        if (!wake_.open()) failWithErrno("eventfd");
        if (!options_.truth_path.empty()) {
            truth_ = Descriptor(
                ::open(options_.truth_path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644));
            if (!truth_.open()) failWithErrno("--truth " + options_.truth_path);
        }
        if (!options_.clock_path.empty()) clock_file_.emplace(options_.clock_path);
        // Robots whose ports were chosen by hand leave nothing to be expected of the others.
        const bool usual = options_.first_port == kFirstPort;
        const auto port = [usual](int first, std::size_t index) {
            return usual ? first + static_cast<int>(index) : 0;
        };
        int next = options_.first_port;
        PictureServer::Ports pictures;
        for (std::size_t i = 0; i < world_.robots.size(); ++i) {
            const auto& robot = world_.robots[i];
            const int arcos = robot.port.value_or(next);
            if (arcos > 65535)
                throw BadDescription(
                    fmt::format("robot {} would get port {}: choose a smaller --port", robot.name, arcos));
            openLink(robots_.emplace_back(lab_.robot(i)), arcos);
            if (arcos != 0) next = arcos + 1;
            pictures.cameras.push_back(port(kFirstCameraPort, i));
            pictures.acts.push_back(port(kFirstActsPort, i));
            tracks_[i].colour = kTrackColours[i % kTrackColours.size()];
        }
        std::map<std::string, std::size_t> of_its_kind;
        for (std::size_t i = 0; i < world_.devices.size(); ++i) {
            const auto& device = world_.devices[i];
            openLink(
                devices_.emplace_back(lab_.device(i)),
                device.port.value_or(port(deviceKind(device.kind)->first_port, of_its_kind[device.kind]++)));
        }
        for (std::size_t i = 0; options_.lasers && i < world_.robots.size(); ++i) {
            openLink(lasers_.emplace_back(lab_.laser(i)), port(kFirstLaserPort, i));
        }
        control_listener_ = listenOn(options_.listen, port(kControlPort, 0));
        if (options_.overview) pictures.overview = port(kOverviewPort, 0);
        picture_server_.emplace(options_.listen, pictures);
        told_objects_.resize(world_.objects.size());
        told_devices_.resize(world_.devices.size());
    }
    ~Loop() override {
        if (picture_server_) picture_server_->stop();
    }

    std::vector<int> ports() const {
        std::vector<int> ports;
        for (const auto& link : robots_) ports.push_back(link.terminal ? 0 : portOf(link.listener));
        return ports;
    }

    std::vector<std::pair<std::string, std::string>> addresses() const {
        std::vector<std::pair<std::string, std::string>> result;
        const auto add = [&](const std::string& name, int port) {
            result.emplace_back(name, fmt::format("{}:{}", options_.listen, port));
        };
        const auto addLink = [&](const std::string& name, const Link& link) {
            if (link.terminal)
                result.emplace_back(name, link.terminal->path);
            else
                add(name, portOf(link.listener));
        };
        const auto pictures = picture_server_->ports();
        for (std::size_t i = 0; i < robots_.size(); ++i) {
            const auto& name = world_.robots[i].name;
            addLink(name, robots_[i]);
            if (options_.lasers) addLink(name + ".laser", lasers_[i]);
            add(name + ".camera", pictures.cameras[i]);
            add(name + ".acts", pictures.acts[i]);
        }
        for (std::size_t i = 0; i < devices_.size(); ++i) addLink(world_.devices[i].name, devices_[i]);
        add("control", portOf(control_listener_));
        if (pictures.overview) add("overview", *pictures.overview);
        return result;
    }

    void stop() noexcept {
        const std::uint64_t one = 1;
        [[maybe_unused]] const auto written = ::write(wake_.get(), &one, sizeof one);
    }

    void run() {
        // Not before: a laboratory that is never run needs no threads.
        cameras_.emplace(lab_.physics(), robots_.size(),
                         [this](std::size_t view, SharedPicture picture, Duration /*age*/) {
                             picture_server_->newPicture(view, std::move(picture));
                         });
        picture_server_->start(*cameras_);
        rebase();
        while (true) {
            watch();
            if (standing()) {
                // Whoever says "step" is not to wait for a tick.
                ::poll(
                    watched_.data(), watched_.size(),
                    static_cast<int>(std::chrono::duration_cast<std::chrono::milliseconds>(kTick).count()));
            } else if (pendingStep() || behind_) {
                ::poll(watched_.data(), watched_.size(), 0);
            } else {
                // Sleeping in whole ticks, whatever arrives: commands wait for the next tick, 100 wake-ups a
                // second suffice.
                next_tick_ = std::max(next_tick_ + tick(), clock_.now());
                waitUntil(next_tick_);
                ::poll(watched_.data(), watched_.size(), 0);
            }
            if ((watched_[0].revents & POLLIN) != 0) return;
            serveClients();
            if (pendingStep()) {
                const auto until = std::min(lab_.age() + Pace::kSlice, *pendingStep());
                while (lab_.age() < until) step();
                rebase();
            } else if (!paused_) {
                keepPace();
            }
            answerHeld();
            tellTime();  // also where time stands: the laboratory is not gone
            cameras_->offer(lab_.age(), keepUp());
        }
    }

  private:
    struct Link {
        explicit Link(ClientLine& of) : line(of) {}

        ClientLine& line;
        Descriptor listener{};
        Descriptor client{};
        std::optional<Terminal> terminal{};  // with --pty: there is no listener, and no client
        bool broken = false;

        int fd() const { return terminal ? terminal->master.get() : client.get(); }
    };
    struct ControlClient {
        Descriptor socket;
        std::string in;
        std::string out;
        std::optional<Duration> until;  // the answer in `held` is sent when the laboratory is that old,
        std::future<void> work;         // or when this is ready
        std::string held;
        bool broken = false;
    };

    Laboratory::LaserLines laserLines() {
        if (!options_.lasers) return {};
        return {.send = [this](std::size_t robot, const arcos::Bytes& bytes) { send(lasers_[robot], bytes); },
                .serial = options_.pty};
    }

    void openLink(Link& link, int port) const {
        if (!options_.pty) {
            link.listener = listenOn(options_.listen, port);
            return;
        }
        link.terminal = openTerminal();
        link.line.clientConnected();  // nobody knocks on a serial line: it is heard from the start
    }

    Duration tick() const {
        return std::clamp(std::chrono::duration_cast<Duration>(kTick / std::max(1.0, speed_)), kShortestTick,
                          kTick);
    }
    bool standing() const { return paused_ && !pendingStep(); }
    bool keepUp() const { return stepping_ || paused_ || speed_ > 1; }

    void rebase() { pace_.rebase(clock_.now(), lab_.age()); }

    void keepPace() {
        const auto order = pace_.next(clock_.now(), lab_.age(), speed_);
        behind_ = order.behind;
        given_up_ += order.given_up;
        // On a time that everybody shares a hiccup costs nobody anything; a speed that is not reached does.
        if (given_up_ > (clock_file_ ? kLongestSilentLoss + lab_.age() / 10 : Duration::zero())) noteLag();
        while (lab_.age() < order.until) {
            step();
            // At high speeds a tick is many pictures long.
            if (speed_ > 1) cameras_->offer(lab_.age(), true);
        }
    }

    void waitUntil(TimePoint when) const {
        const auto left = when - clock_.now();
        if (left <= Duration::zero()) return;
        pollfd wake{wake_.get(), POLLIN, 0};
        const timespec time{0, static_cast<long>(left.count())};
        ::ppoll(&wake, 1, &time, nullptr);
    }

    void step() {
        lab_.step();
        tellTime();
        if (lab_.age() >= next_truth_) {
            next_truth_ = lab_.age() + kTruthPeriod - lab_.age() % kTruthPeriod;
            followTracks();
            if (truth_.open()) writeTruth();
        }
        for (auto* links : {&robots_, &devices_, &lasers_}) {
            for (auto& link : *links) {
                if (!link.broken) continue;
                hearOut(link);  // its last order may be to stop
                drop(link);
            }
        }
    }

    void tellTime() {
        const auto step = pendingStep();  // of which who asked may still have to be told that it is over
        const double rate = step && *step > lab_.age() ? kStepRate : paused_ ? 0 : speed_;
        if (clock_file_) clock_file_->tell(lab_.age(), rate, clock_.now());
    }

    void noteLag() {
        if (std::exchange(lag_noted_, true)) return;
        complain("this machine is too slow for the asked speed, or was suspended; the world runs behind");
    }

    void watch() {
        watched_.assign(1, {wake_.get(), POLLIN, 0});
        const auto add = [this](int fd, short events = POLLIN) {
            watched_.push_back({fd, events, 0});  // a negative descriptor is passed over
        };
        for (auto* links : {&robots_, &devices_, &lasers_}) {
            for (const auto& link : *links) add(link.listener.get()), add(link.fd());
        }
        add(control_listener_.get());
        for (const auto& client : control_clients_)
            add(client.socket.get(), static_cast<short>(POLLIN | (client.out.empty() ? 0 : POLLOUT)));
    }

    void serveClients() {
        std::size_t at = 1;
        for (auto* links : {&robots_, &devices_, &lasers_}) {
            for (auto& link : *links) {
                const auto knocked = watched_[at++].revents;
                const auto spoke = watched_[at++].revents;
                if (spoke != 0) read(link);
                if (knocked != 0) accept(link);
            }
        }
        const auto knocked = watched_[at++].revents;
        for (auto& client : control_clients_) {
            const auto events = watched_[at++].revents;
            if ((events & (POLLIN | POLLHUP | POLLERR)) != 0) read(client);
            flush(client);
        }
        control_clients_.remove_if([](const ControlClient& client) { return client.broken; });
        if (knocked != 0) {
            auto socket = acceptFrom(control_listener_);
            if (socket.open() && control_clients_.size() < kMostControlClients)
                control_clients_.push_back(
                    {.socket = std::move(socket), .in = {}, .out = {}, .until = {}, .work = {}, .held = {}});
        }
    }

    void accept(Link& link) {
        // Whoever closes and connects again within a tick has closed first.
        hearOut(link);
        auto client = acceptFrom(link.listener);
        if (!client.open() || link.client.open()) return;  // busy: closing the connection is the refusal
        link.client = std::move(client);
        link.broken = false;
        link.line.clientConnected();
    }

    /// What a client has said already, before something happens to its connection.
    void hearOut(Link& link) {
        for (int i = 0; link.client.open() && i < kMostReads && read(link); ++i) continue;
    }

    /// False when there was nothing, or the client is gone.
    bool read(Link& link) {
        std::array<std::uint8_t, 4096> chunk;
        const auto got = ::read(link.fd(), chunk.data(), chunk.size());
        if (got > 0) {
            const auto bytes = std::span(chunk).first(static_cast<std::size_t>(got));
            const bool noise = garbled(link);
            if (noise) garble(bytes);
            // At the speed that the line had before the client changed it. What breaks here is dropped by
            // step(), when the client was heard out: its last order may be to stop.
            send(link, link.line.receive(bytes), noise);
        } else if (got == 0 || (errno != EAGAIN && errno != EINTR)) {
            drop(link);
        }
        return got > 0;
    }

    bool garbled(const Link& link) const {
        const int speed = link.terminal ? link.line.baud() : 0;
        return speed != 0 && speedOf(*link.terminal) != speed;
    }
    /// What a byte looks like at another speed: not like this, but it is none that was sent either.
    static void garble(std::span<std::uint8_t> bytes) {
        for (auto& byte : bytes) byte ^= 0x5AU;
    }

    void send(Link& link, std::span<const std::uint8_t> bytes) const { send(link, bytes, garbled(link)); }
    void send(Link& link, std::span<const std::uint8_t> bytes, bool noise) const {
        if (link.fd() < 0 || bytes.empty()) return;
        if (link.terminal) {
            arcos::Bytes said(bytes.begin(), bytes.end());
            if (noise) garble(said);
            // A serial line does not wait: what nobody reads is lost.
            [[maybe_unused]] const auto written = ::write(link.fd(), said.data(), said.size());
            return;
        }
        const auto sent = ::send(link.fd(), bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
        // Not dropped here: the laboratory may be in the middle of a step.
        if (sent != static_cast<ssize_t>(bytes.size())) link.broken = true;
    }

    void drop(Link& link) {
        link.broken = false;
        if (!link.client.open()) return;
        link.client.reset();
        link.line.clientLost();
    }

    void read(ControlClient& client) {
        std::array<char, 4096> chunk;
        const auto got = ::recv(client.socket.get(), chunk.data(), chunk.size(), 0);
        if (got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR)) {
            client.broken = true;
            return;
        }
        if (got > 0) client.in.append(chunk.data(), static_cast<std::size_t>(got));
        obey(client);
        if (client.in.size() > kLongestRequest) client.broken = true;
    }

    /// One after the other: what comes after a "step" or a "picture" waits for its end.
    void obey(ControlClient& client) {
        std::size_t end = 0;
        while (!client.until && !client.work.valid() && (end = client.in.find('\n')) != std::string::npos) {
            auto line = client.in.substr(0, end);
            client.in.erase(0, end + 1);
            if (!line.empty() && line.back() == '\r') line.pop_back();
            if (line.empty()) continue;
            auto reply = control_.handle(line);
            if (reply.until && *reply.until > lab_.age()) {
                client.until = reply.until;
                client.held = std::move(reply.line);
            } else if (reply.work.valid()) {
                client.work = std::move(reply.work);
                client.held = std::move(reply.line);
            } else {
                client.out += reply.line + '\n';
            }
        }
    }

    std::optional<Duration> pendingStep() const {
        std::optional<Duration> first;
        for (const auto& client : control_clients_) {
            if (client.until && (!first || *client.until < *first)) first = client.until;
        }
        return first;
    }

    void answerHeld() {
        for (auto& client : control_clients_) {
            const bool grown = client.until && lab_.age() >= *client.until;
            const bool done = client.work.valid() &&
                              client.work.wait_for(std::chrono::seconds{0}) == std::future_status::ready;
            if (grown || done) {
                client.until.reset();
                if (done) finish(client);
                client.out += client.held + '\n';
                obey(client);
            }
            flush(client);
        }
    }

    static void finish(ControlClient& client) try { client.work.get(); } catch (const std::exception& error) {
        client.held = Control::failed(error);
    }

    static void flush(ControlClient& client) {
        if (client.out.empty()) return;
        const auto sent =
            ::send(client.socket.get(), client.out.data(), client.out.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
        if (sent > 0) client.out.erase(0, static_cast<std::size_t>(sent));
        if (sent < 0 && errno != EAGAIN && errno != EINTR) client.broken = true;
    }

    void pause(bool paused) override {
        paused_ = paused;
        rebase();
    }
    bool paused() const override { return paused_; }
    void setSpeed(double factor) override {
        speed_ = factor;
        rebase();
    }
    double speed() const override { return speed_; }
    void reset() override {
        lab_.reset();
        for (auto& track : tracks_) track.points.clear();
        std::fill(told_objects_.begin(), told_objects_.end(), std::nullopt);
    }
    std::future<void> writePicture(const std::string& file, bool tracks) override {
        followTracks();
        return cameras_->take(cameras_->overview(), tracks ? tracks_ : std::vector<Track>{},
                              [file](const Picture& picture) { writePng(file, picture); });
    }

    void followTracks() {
        for (std::size_t i = 0; i < tracks_.size(); ++i) {
            const auto t = lab_.truth(i);
            auto& points = tracks_[i].points;
            if (points.size() < kLongestTrack &&
                (points.empty() ||
                 std::hypot(points.back()[0] - t.x_m, points.back()[1] - t.y_m) >= kTrackStep_m))
                points.push_back({t.x_m, t.y_m});
        }
    }

    void writeTruth() {
        const auto stamp =
            fmt::format(R"({{"time_s":{:.3f},"monotonic_us":{})",
                        std::chrono::duration<double>(lab_.age()).count(), toMicroseconds(clock_.now()));
        std::string lines;
        const auto objects = lab_.physics().truthOfObjects();
        for (std::size_t i = 0; i < objects.size() && i < told_objects_.size(); ++i) {
            const auto& o = objects[i];
            const std::array<double, 4> now{o.x_m, o.y_m, o.z_m, o.tilt_deg / 100};
            if (!moved(told_objects_[i], now, 0.001)) continue;
            lines += fmt::format(
                R"({},"object":"{}","x_m":{:.4f},"y_m":{:.4f},"z_m":{:.4f},"theta_deg":{:.2f},"tilt_deg":{:.2f}}})"
                "\n",
                stamp, o.name, o.x_m, o.y_m, o.z_m, o.theta_deg, o.tilt_deg);
        }
        for (std::size_t i = 0; i < told_devices_.size(); ++i) {
            const auto truth = lab_.device(i).truth();
            if (!moved(told_devices_[i], truth)) continue;
            const auto& device = world_.devices[i];
            lines += fmt::format(R"({},"{}":"{}")", stamp, deviceKind(device.kind)->noun, device.name);
            for (const auto& measure : truth) {
                const bool list = measure.value.index() == 1;
                lines += fmt::format(R"(,"{}":{}{:.2f}{})", measure.name, list ? "[" : "",
                                     fmt::join(numbersOf(measure), ","), list ? "]" : "");
            }
            lines += "}\n";
        }
        // Robots last: whoever wants a robot's newest place reads the end of the file.
        for (std::size_t i = 0; i < world_.robots.size(); ++i) {
            const auto t = lab_.truth(i);
            lines += fmt::format(
                R"({},"name":"{}","robot":{},"x_m":{:.4f},"y_m":{:.4f},"theta_deg":{:.2f},"speed_m_s":{:.4f},"rotation_deg_s":{:.2f}}})"
                "\n",
                stamp, world_.robots[i].name, i, t.x_m, t.y_m, t.theta_deg, t.speed_m_s, t.rotation_deg_s);
        }
        if (::write(truth_.get(), lines.data(), lines.size()) < 0) {
            std::perror("axon-lab: --truth");
            truth_.reset();
        }
    }

    template <std::size_t N>
    static bool moved(std::optional<std::array<double, N>>& told, const std::array<double, N>& now,
                      double least) {
        bool far = !told;
        for (std::size_t i = 0; i < N && !far; ++i) far = std::abs((*told)[i] - now[i]) > least;
        if (far) told = now;
        return far;
    }

    static std::vector<double> numbersOf(const Measure& measure) {
        if (const auto* number = std::get_if<double>(&measure.value)) return {*number};
        return std::get<std::vector<double>>(measure.value);
    }
    static bool moved(std::optional<std::vector<Measure>>& told, const std::vector<Measure>& now) {
        bool far = !told;
        for (std::size_t i = 0; i < now.size() && !far; ++i) {
            const auto before = numbersOf((*told)[i]);
            const auto after = numbersOf(now[i]);
            for (std::size_t k = 0; k < after.size(); ++k)
                far = far || std::abs(after[k] - before[k]) > now[i].least_move;
        }
        if (far) told = now;
        return far;
    }

    const Options options_;
    const WorldDescription world_;
    const SteadyClock clock_{};
    Descriptor wake_;
    Laboratory lab_;
    Control control_{lab_, world_, *this};
    std::vector<Link> robots_;
    std::vector<Link> devices_;
    std::vector<Link> lasers_;
    Descriptor control_listener_;
    std::list<ControlClient> control_clients_;
    std::vector<pollfd> watched_;

    double speed_;
    bool paused_;
    const bool stepping_;
    Pace pace_;
    bool behind_ = false;
    Duration given_up_{};  // of the world, altogether
    TimePoint next_tick_{};
    bool lag_noted_ = false;

    Descriptor truth_;
    Duration next_truth_{};
    std::vector<std::optional<std::array<double, 4>>> told_objects_;
    std::vector<std::optional<std::vector<Measure>>> told_devices_;
    std::optional<ClockFile> clock_file_;
    std::vector<Track> tracks_;

    // The cameras' thread gives pictures to the server, the server's asks the cameras: the server stops
    // first, and goes last.
    std::optional<PictureServer> picture_server_;
    std::optional<Cameras> cameras_;
};

LabServer::LabServer(WorldDescription world, Options options)
    : loop_(std::make_unique<Loop>(std::move(world), std::move(options))) {}
LabServer::~LabServer() = default;
std::vector<int> LabServer::ports() const {
    return loop_->ports();
}
std::vector<std::pair<std::string, std::string>> LabServer::addresses() const {
    return loop_->addresses();
}
std::string LabServer::address(const std::string& name) const {
    for (auto& [known, address] : loop_->addresses()) {
        if (known == name) return address;
    }
    throw std::out_of_range("the laboratory has no " + name);
}
void LabServer::run() {
    loop_->run();
}
void LabServer::stop() noexcept {
    loop_->stop();
}

}  // namespace axon::lab

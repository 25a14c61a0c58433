// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/camera.hpp"

#include <GL/osmesa.h>
#include <dlfcn.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <exception>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <utility>

#include "lab/physics_view.hpp"

namespace axon::lab {
namespace {

constexpr int kOverviewWidth = 640;
constexpr int kOverviewHeight = 480;
constexpr int kStillWidth = 1280;
constexpr int kStillHeight = 960;
// Drawn so many times larger and averaged: smooths edges at a tenth of what MSAA costs in software.
constexpr int kOverviewOversampling = 1;
constexpr int kStillOversampling = 2;
constexpr int kMostGeoms = 6000;
constexpr std::size_t kMostTrackPoints = 400;

/// MuJoCo finds the graphics library of a process by its symbols; loaded only now, because it brings a
/// compiler of 100 MB along.
class Graphics {
  public:
    Graphics() {
        void* library = ::dlopen("libOSMesa.so.8", RTLD_NOW | RTLD_GLOBAL);
        if (library == nullptr) library = ::dlopen("libOSMesa.so", RTLD_NOW | RTLD_GLOBAL);
        if (library == nullptr)
            throw std::runtime_error("no pictures: libOSMesa.so.8 is missing; fix: install libosmesa6");
        const auto create =
            reinterpret_cast<decltype(&OSMesaCreateContextExt)>(::dlsym(library, "OSMesaCreateContextExt"));
        const auto make_current =
            reinterpret_cast<decltype(&OSMesaMakeCurrent)>(::dlsym(library, "OSMesaMakeCurrent"));
        destroy_ =
            reinterpret_cast<decltype(&OSMesaDestroyContext)>(::dlsym(library, "OSMesaDestroyContext"));
        if (create == nullptr || make_current == nullptr || destroy_ == nullptr)
            throw std::runtime_error("no pictures: libOSMesa.so.8 is not what it should be");
        context_ = create(OSMESA_RGBA, 24, 8, 8, nullptr);
        // MuJoCo draws into a buffer of its own; this one is never looked at.
        if (context_ == nullptr ||
            make_current(context_, buffer_.data(), GL_UNSIGNED_BYTE, kSide, kSide) == GL_FALSE)
            throw std::runtime_error("no pictures: OSMesa gives no context");
    }
    ~Graphics() {
        if (context_ != nullptr) destroy_(context_);
    }
    Graphics(const Graphics&) = delete;
    Graphics& operator=(const Graphics&) = delete;

  private:
    static constexpr int kSide = 64;
    std::vector<unsigned char> buffer_ = std::vector<unsigned char>(4U * kSide * kSide);
    OSMesaContext context_ = nullptr;
    decltype(&OSMesaDestroyContext) destroy_ = nullptr;
};

/// Belongs to one thread from its construction on.
class Renderer {
  public:
    /// Draws pictures of at most this size. The whole buffer is cleared for each picture, however small that
    /// is, so that large pictures want a renderer of their own.
    Renderer(mjModel* model, int width, int height) {
        model->vis.global.offwidth = width;
        model->vis.global.offheight = height;
        mjv_defaultScene(&scene_);
        mjv_makeScene(model, &scene_, kMostGeoms);
        mjr_defaultContext(&context_);
        mjr_makeContext(model, &context_, mjFONTSCALE_100);
        mjr_setBuffer(mjFB_OFFSCREEN, &context_);
        if (context_.currentBuffer != mjFB_OFFSCREEN)
            throw std::runtime_error("no pictures: the graphics library draws on no buffer");
        mjv_defaultOption(&option_);
        std::fill(std::begin(option_.geomgroup), std::end(option_.geomgroup), mjtByte{1});
        std::fill(std::begin(option_.sitegroup), std::end(option_.sitegroup), mjtByte{0});
        option_.flags[mjVIS_RANGEFINDER] = 0;
    }
    ~Renderer() {
        mjr_freeContext(&context_);
        mjv_freeScene(&scene_);
    }
    Renderer(const Renderer&) = delete;
    Renderer& operator=(const Renderer&) = delete;

    Picture draw(const mjModel* model, mjData* data, const std::string& camera, int width, int height,
                 int oversampling, std::span<const Track> tracks) {
        mjvCamera view;
        mjv_defaultCamera(&view);
        view.type = mjCAMERA_FIXED;
        view.fixedcamid = mj_name2id(model, mjOBJ_CAMERA, camera.c_str());
        if (view.fixedcamid < 0) throw std::runtime_error("no pictures: the world has no camera " + camera);
        mjv_updateScene(model, data, &option_, nullptr, &view, mjCAT_ALL, &scene_);
        for (const auto& track : tracks) addTrack(track);
        // With shadows and reflections a picture costs ten times as much.
        scene_.flags[mjRND_SHADOW] = scene_.flags[mjRND_REFLECTION] = 0;
        const mjrRect port{0, 0, width * oversampling, height * oversampling};
        raw_.resize(static_cast<std::size_t>(port.width) * static_cast<std::size_t>(port.height) * 3U);
        mjr_setBuffer(mjFB_OFFSCREEN, &context_);  // there may be another renderer
        mjr_render(port, &scene_, &context_);
        mjr_readPixels(raw_.data(), nullptr, port, &context_);
        return shrink(width, height, oversampling);
    }

  private:
    void addTrack(const Track& track) {
        const std::size_t every = 1 + track.points.size() / kMostTrackPoints;
        for (std::size_t i = 0; i + 1 < track.points.size() && scene_.ngeom < scene_.maxgeom; i += every) {
            const auto& from = track.points[i];
            const auto& to = track.points[std::min(i + every, track.points.size() - 1)];
            auto* geom = scene_.geoms + scene_.ngeom++;
            const std::array<float, 4> colour{track.colour[0], track.colour[1], track.colour[2], 1};
            mjv_initGeom(geom, mjGEOM_CAPSULE, nullptr, nullptr, nullptr, colour.data());
            mjv_makeConnector(geom, mjGEOM_CAPSULE, 0.02, from[0], from[1], 0.02, to[0], to[1], 0.02);
            geom->emission = 0.6F;
        }
    }

    /// MuJoCo gives the bottom row first.
    Picture shrink(int width, int height, int oversampling) const {
        Picture picture{width, height, {}};
        const auto w = static_cast<std::size_t>(width);
        const auto h = static_cast<std::size_t>(height);
        const auto n = static_cast<std::size_t>(oversampling);
        picture.rgb.resize(w * h * 3);
        for (std::size_t y = 0; y < h; ++y) {
            auto* to = picture.rgb.data() + y * w * 3;
            const auto* from = raw_.data() + (h - 1 - y) * n * n * w * 3;
            if (n == 1) {
                std::memcpy(to, from, w * 3);
                continue;
            }
            for (std::size_t x = 0; x < w; ++x) {
                for (std::size_t c = 0; c < 3; ++c) {
                    unsigned sum = 0;
                    for (std::size_t j = 0; j < n; ++j)
                        for (std::size_t i = 0; i < n; ++i) sum += from[(j * w * n + x * n + i) * 3 + c];
                    to[x * 3 + c] = static_cast<std::uint8_t>(sum / (n * n));
                }
            }
        }
        return picture;
    }

    mjvScene scene_;
    mjrContext context_;
    mjvOption option_;
    std::vector<unsigned char> raw_;
};

}  // namespace

class Cameras::Studio {
  public:
    Studio(const Physics& physics, std::size_t robots, OnPicture on_picture)
        : view_(physics),
          robots_(robots),
          on_picture_(std::move(on_picture)),
          watchers_(robots + 1),
          wanted_(robots + 1),
          model_(mj_copyModel(nullptr, view_.model()), &mj_deleteModel),
          data_(mj_makeData(model_.get()), &mj_deleteData) {
        auto& visual = model_->vis;
        visual.quality.shadowsize = 0;
        visual.quality.offsamples = 0;
        thread_ = std::thread([this] { run(); });
    }
    ~Studio() {
        {
            const std::lock_guard lock(mutex_);
            ending_ = true;
        }
        changed_.notify_all();
        thread_.join();
    }

    void watch(std::size_t view, bool more) {
        watchers_[view] += more ? 1 : -1;
        if (more) wanted_[view] = true;  // the first one does not wait for the next period
    }
    void wantOne(std::size_t view) { wanted_[view] = true; }

    void offer(Duration age, bool keep_up) {
        const bool due = age >= next_;
        if (due) next_ = age + kPeriod - (age % kPeriod);
        if (age < last_age_) next_ = Duration{};  // the world began anew
        last_age_ = age;
        if (!stills_.empty()) beginStill();
        std::vector<std::size_t> views;
        for (std::size_t i = 0; i <= robots_; ++i) {
            if ((due && watchers_[i] > 0) || wanted_[i]) views.push_back(i);
        }
        if (views.empty()) return;
        std::unique_lock lock(mutex_);
        if (failure_) return;
        if (!order_.empty() || drawing_) {
            if (!keep_up) {
                if (due) ++left_out_;
                return;  // what is wanted once stays wanted
            }
            changed_.wait(lock, [this] { return order_.empty() && !drawing_; });
        }
        copyWorld();
        for (const auto view : views) {
            wanted_[view] = false;
            order_.push_back({view, age, {}});
        }
        if (!stills_.empty()) {  // else one picture after another that is watched could keep it waiting
            const auto view = stills_.front()->view;
            order_.push_back({view, age, std::move(stills_.front())});
            stills_.pop_front();
        }
        lock.unlock();
        changed_.notify_all();
    }

    std::future<void> take(std::size_t view, std::vector<Track> tracks, Use use) {
        stills_.push_back(std::make_unique<Still>(view, std::move(tracks), std::move(use)));
        auto done = stills_.back()->done.get_future();
        beginStill();
        return done;
    }

    std::optional<std::string> failure() const {
        const std::lock_guard lock(mutex_);
        return failure_;
    }
    std::uint64_t drawn() const { return drawn_; }
    std::uint64_t leftOut() const { return left_out_; }

  private:
    struct Still {
        Still(std::size_t of, std::vector<Track> its_tracks, Use its_use)
            : view(of), tracks(std::move(its_tracks)), use(std::move(its_use)) {}

        std::size_t view;
        std::vector<Track> tracks;
        Use use;
        std::promise<void> done;
    };
    struct Order {
        std::size_t view;
        Duration age;
        std::unique_ptr<Still> still;  // none: for on_picture_
    };

    struct Drawn {
        const Order* order;
        Picture picture;
        std::exception_ptr problem;
    };

    /// Orders the next picture that was asked for by take(), if the drawing thread is free.
    void beginStill() {
        {
            const std::lock_guard lock(mutex_);
            if (!order_.empty() || drawing_) return;
            copyWorld();
            const auto view = stills_.front()->view;
            order_.push_back({view, last_age_, std::move(stills_.front())});
        }
        stills_.pop_front();
        changed_.notify_all();
    }

    /// While nothing is ordered and nothing is drawn, the drawing thread does not look at the copies.
    void copyWorld() { view_.copyTo(model_.get(), data_.get()); }

    void run() {
        std::unique_ptr<Graphics> graphics;
        std::unique_ptr<Renderer> renderer;
        std::unique_lock lock(mutex_);
        while (true) {
            changed_.wait(lock, [this] { return ending_ || !order_.empty(); });
            if (ending_) return;
            const auto orders = std::exchange(order_, {});
            auto failure = failure_;
            drawing_ = true;
            lock.unlock();
            std::vector<Drawn> results;
            for (const auto& order : orders) {
                try {
                    if (failure) throw std::runtime_error(*failure);
                    if (!renderer) {
                        graphics = std::make_unique<Graphics>();
                        renderer = std::make_unique<Renderer>(model_.get(), kOverviewWidth, kOverviewHeight);
                    }
                    results.push_back({&order, draw(*renderer, order), nullptr});
                    ++drawn_;
                } catch (const std::exception& error) {
                    failure = error.what();
                    results.push_back({&order, {}, std::current_exception()});
                }
            }
            lock.lock();
            failure_ = failure;
            drawing_ = false;  // before anybody is given a picture, who may ask for the next one at once
            lock.unlock();
            changed_.notify_all();
            for (auto& [order, picture, problem] : results) {
                if (order->still && problem)
                    order->still->done.set_exception(problem);
                else if (order->still)
                    give(*order->still, std::move(picture));
                else if (!problem)
                    on_picture_(order->view, std::make_shared<const Picture>(std::move(picture)), order->age);
            }
            lock.lock();
        }
    }

    static void give(Still& still, Picture picture) {
        try {
            still.use(std::move(picture));
            still.done.set_value();
        } catch (...) {
            still.done.set_exception(std::current_exception());
        }
    }

    Picture draw(Renderer& renderer, const Order& order) {
        const auto tracks =
            order.still ? std::span<const Track>(order.still->tracks) : std::span<const Track>();
        if (order.view < robots_) {
            return renderer.draw(model_.get(), data_.get(), view_.cameraName(order.view), kWidth, kHeight, 1,
                                 tracks);
        }
        if (order.still) {
            // Made for each, because they are rare and their buffers take 40 MB.
            Renderer large(model_.get(), kStillWidth * kStillOversampling, kStillHeight * kStillOversampling);
            return large.draw(model_.get(), data_.get(), kOverview, kStillWidth, kStillHeight,
                              kStillOversampling, tracks);
        }
        return renderer.draw(model_.get(), data_.get(), kOverview, kOverviewWidth, kOverviewHeight,
                             kOverviewOversampling, tracks);
    }

    // Constant after construction.
    const PhysicsView view_;
    const std::size_t robots_;
    const OnPicture on_picture_;

    std::vector<std::atomic<int>> watchers_;
    std::vector<std::atomic<bool>> wanted_;
    std::atomic<std::uint64_t> drawn_{0};
    std::atomic<std::uint64_t> left_out_{0};

    // Of the thread that steps.
    Duration next_{};
    Duration last_age_{};
    std::deque<std::unique_ptr<Still>> stills_;  // asked for, and not yet ordered

    // Of the stepping thread while order_ is empty and drawing_ is false, else of the drawing one.
    std::unique_ptr<mjModel, decltype(&mj_deleteModel)> model_;
    std::unique_ptr<mjData, decltype(&mj_deleteData)> data_;

    // Guarded by mutex_.
    mutable std::mutex mutex_;
    std::condition_variable changed_;
    std::vector<Order> order_;
    std::optional<std::string> failure_;
    bool drawing_ = false;
    bool ending_ = false;

    std::thread thread_;
};

Cameras::Cameras(const Physics& physics, std::size_t robots, OnPicture on_picture)
    : robots_(robots), studio_(std::make_unique<Studio>(physics, robots, std::move(on_picture))) {}
Cameras::~Cameras() = default;
void Cameras::watch(std::size_t view, bool more) {
    studio_->watch(view, more);
}
void Cameras::wantOne(std::size_t view) {
    studio_->wantOne(view);
}
void Cameras::offer(Duration age, bool keep_up) {
    studio_->offer(age, keep_up);
}
std::future<void> Cameras::take(std::size_t view, std::vector<Track> tracks, Use use) {
    return studio_->take(view, std::move(tracks), std::move(use));
}
std::optional<std::string> Cameras::failure() const {
    return studio_->failure();
}
std::uint64_t Cameras::drawn() const {
    return studio_->drawn();
}
std::uint64_t Cameras::leftOut() const {
    return studio_->leftOut();
}

}  // namespace axon::lab

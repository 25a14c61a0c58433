// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "lab/camera.hpp"

namespace axon::lab {

/// What a browser, or a robot application, may ask of a camera: the reading half of an HTTP/1.1 server that
/// closes after each answer. No I/O.
struct PictureRequest {
    enum class Kind { Stream, Jpeg, Png, Raw, Page, NotFound, NotAllowed };
    Kind kind = Kind::NotFound;
};
/// Nothing until the request is whole. `overview` chooses which paths there are. Longer than 8 KB is
/// NotAllowed.
std::optional<PictureRequest> parsePictureRequest(std::string_view bytes, bool overview);

/// The pictures of a laboratory on TCP: for each robot a port with its camera and one with the colour blobs
/// (ACTS), and if wanted one with the overview.
///
/// | port | path | gives |
/// |---|---|---|
/// | camera | /stream | multipart/x-mixed-replace of JPEG |
/// | | /frame.jpg | one picture, made after it was asked for |
/// | | /raw | binary PPM pictures one after the other, without end, 10 a second of the laboratory's time |
/// | overview | /overview/stream, /overview.png | the same of the room |
///
/// A view is drawn only while somebody is connected who wants it. Who reads too slowly misses pictures, never
/// parts of one.
/// Threads: one of its own for all connections. The cameras must outlive it; newPicture() may be called by
/// any thread and does not block. The constructor listens already, throws std::system_error; start() begins
/// to answer.
class PictureServer {
  public:
    struct Ports {
        std::vector<int> cameras;  ///< of each robot; 0: a free one
        std::vector<int> acts;
        std::optional<int> overview;
    };

    PictureServer(const std::string& address, const Ports& ports);
    ~PictureServer();
    PictureServer(const PictureServer&) = delete;
    PictureServer& operator=(const PictureServer&) = delete;

    /// Those that it got.
    Ports ports() const;
    void start(Cameras& cameras);
    /// Before the cameras go.
    void stop();
    void newPicture(std::size_t view, SharedPicture picture);

  private:
    class Loop;
    std::unique_ptr<Loop> loop_;
};

}  // namespace axon::lab

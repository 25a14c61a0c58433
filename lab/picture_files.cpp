// SPDX-License-Identifier: GPL-2.0-or-later
#include <fmt/format.h>
#include <png.h>
// jpeglib.h needs FILE before it.
#include <cstdio>
#include <cstdlib>
#include <stdexcept>

#include <jpeglib.h>

#include "lab/camera.hpp"

namespace axon::lab {

std::vector<std::uint8_t> encodeJpeg(const Picture& picture, int quality) {
    jpeg_compress_struct jpeg{};
    jpeg_error_mgr errors{};
    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_compress(&jpeg);
    unsigned char* bytes = nullptr;
    unsigned long size = 0;
    jpeg_mem_dest(&jpeg, &bytes, &size);
    jpeg.image_width = static_cast<JDIMENSION>(picture.width);
    jpeg.image_height = static_cast<JDIMENSION>(picture.height);
    jpeg.input_components = 3;
    jpeg.in_color_space = JCS_RGB;
    jpeg_set_defaults(&jpeg);
    jpeg_set_quality(&jpeg, quality, TRUE);
    jpeg_start_compress(&jpeg, TRUE);
    while (jpeg.next_scanline < jpeg.image_height) {
        auto* row = const_cast<JSAMPROW>(picture.rgb.data() + static_cast<std::size_t>(jpeg.next_scanline) *
                                                                  3U * jpeg.image_width);
        jpeg_write_scanlines(&jpeg, &row, 1);
    }
    jpeg_finish_compress(&jpeg);
    std::vector<std::uint8_t> result(bytes, bytes + size);
    jpeg_destroy_compress(&jpeg);
    std::free(bytes);
    return result;
}

std::vector<std::uint8_t> encodePng(const Picture& picture) {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    image.width = static_cast<png_uint_32>(picture.width);
    image.height = static_cast<png_uint_32>(picture.height);
    image.format = PNG_FORMAT_RGB;
    png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(image);
    std::vector<std::uint8_t> result(size);
    if (png_image_write_to_memory(&image, result.data(), &size, 0, picture.rgb.data(), 0, nullptr) == 0)
        throw std::runtime_error(fmt::format("a picture cannot be written as PNG: {}", image.message));
    result.resize(size);
    return result;
}

std::vector<std::uint8_t> encodePpm(const Picture& picture) {
    const auto head = fmt::format("P6\n{} {}\n255\n", picture.width, picture.height);
    std::vector<std::uint8_t> result(head.begin(), head.end());
    result.insert(result.end(), picture.rgb.begin(), picture.rgb.end());
    return result;
}

void writePng(const std::string& path, const Picture& picture) {
    const auto bytes = encodePng(picture);
    std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "wb"), &std::fclose);
    if (!file || std::fwrite(bytes.data(), 1, bytes.size(), file.get()) != bytes.size() ||
        std::fflush(file.get()) != 0)
        throw std::runtime_error(fmt::format("cannot write the picture {}: does its folder exist?", path));
}

}  // namespace axon::lab

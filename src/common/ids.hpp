// SPDX-License-Identifier: MIT
#pragma once
#include <array>
#include <compare>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

namespace axon {

/// Where a pure core gets its random bytes from; a simulation injects a seeded one.
class RandomSource {
  public:
    virtual ~RandomSource() = default;
    virtual void fill(void* bytes, std::size_t count) = 0;
};

/// The kernel's getrandom(2); thread-safe. Throws std::system_error where the kernel refuses.
class SystemRandom final : public RandomSource {
  public:
    void fill(void* bytes, std::size_t count) override;
};

/// SplitMix64 from a seed: reproducible, for tests and simulations only. Not thread-safe.
class SeededRandom final : public RandomSource {
  public:
    explicit SeededRandom(std::uint64_t seed) : state_(seed) {}
    void fill(void* bytes, std::size_t count) override;
    std::uint64_t next();

  private:
    std::uint64_t state_;
};

/// 128 bits: entity UUIDs, task ids, request ids, lease keys, nonces. A value type, ordered and hashable.
class Id128 {
  public:
    Id128() = default;
    static Id128 random(RandomSource& source);
    /// A version 4 UUID (RFC 9562) from the source.
    static Id128 uuid(RandomSource& source);
    /// Exactly 16 raw bytes, as protobuf carries them; nothing else is accepted.
    static std::optional<Id128> fromBytes(std::string_view bytes);
    /// The 36 characters of a UUID, upper or lower case.
    static std::optional<Id128> parse(std::string_view text);

    std::string bytes() const { return {reinterpret_cast<const char*>(value_.data()), value_.size()}; }
    /// 8-4-4-4-12 lower-case hexadecimal digits.
    std::string toString() const;
    bool isZero() const { return *this == Id128{}; }
    auto operator<=>(const Id128&) const = default;

  private:
    friend struct std::hash<Id128>;
    std::array<std::uint8_t, 16> value_{};
};

}  // namespace axon

template <>
struct std::hash<axon::Id128> {
    std::size_t operator()(const axon::Id128& id) const noexcept {
        return std::hash<std::string_view>{}({reinterpret_cast<const char*>(id.value_.data()), 16});
    }
};

// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <string_view>
#include <vector>

// Text on a terminal. Pure functions.
namespace axon::cli {

enum class Tint { None, Bold, Dim, Green, Yellow, Red, Cyan };

/// With the terminal's escape sequences around it, where `colour` allows.
std::string tinted(std::string_view text, Tint tint, bool colour);

/// What a robot, another user or a file says, made harmless: control characters, escape sequences among them,
/// and bytes that are no UTF-8 become '?'. Line ends stay where `lines` is set and become spaces otherwise.
std::string printable(std::string_view text, bool lines = false);

/// The columns that the text takes on a terminal: 2 for East Asian wide characters, 0 for combining ones.
std::size_t columns(std::string_view text);

/// The beginning that fits, with "…" where something is left out.
std::string shortened(std::string_view text, std::size_t width);

struct Cell {
    std::string text;
    Tint tint = Tint::None;
};

/// Rows of left-aligned columns, two spaces between them, no trailing spaces. Every row begins with `indent`
/// spaces. Empty columns (no cell but the head has text) are left out.
class Table {
  public:
    explicit Table(std::vector<std::string> head, std::size_t indent = 0)
        : head_(std::move(head)), indent_(indent) {}
    void add(std::vector<Cell> row) { rows_.push_back(std::move(row)); }
    std::string text(bool colour) const;

  private:
    std::vector<std::string> head_;
    std::size_t indent_;
    std::vector<std::vector<Cell>> rows_;
};

}  // namespace axon::cli

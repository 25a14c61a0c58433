#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What pages can say to page_test.py, and the code that tools/quote.py puts into them."""
import pathlib
import sys
import tempfile
import unittest

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent.parent / "tools")]
import console  # noqa: E402
import quote  # noqa: E402


class PageTest(unittest.TestCase):
    def test_comments_directly_before_a_block_are_about_it_and_end_with_other_text(self):
        one, two = console.blocks("<!-- terminal: robot -->\n<!-- stays -->\n```console\n$ a\n```\n"
                                  "<!-- status: 1 -->\ntext\n```console\n$ b\n```\n")
        self.assertEqual(one.directives, {"terminal": "robot", "stays": ""})
        self.assertEqual(two.directives, {})
        self.assertEqual((one.line, two.line), (3, 8))

    def test_a_block_without_an_end_is_an_error(self):
        with self.assertRaises(console.Differs):
            console.blocks("```console\n$ a\n")

    def test_a_console_block_is_commands_with_what_they_print(self):
        block, = console.blocks("```console\n$ a \\\n>   b\nout\n> not typed\n^C\nend\n```")
        self.assertEqual([(step.typed, step.expected) for step in console.steps(block)],
                         [("a \\\n  b", ["out", "> not typed"]), ("^C", ["end"])])

    def test_a_block_without_a_command_is_what_was_printed_meanwhile(self):
        block, = console.blocks("```console\nsaid\n```")
        self.assertEqual([(step.typed, step.expected) for step in console.steps(block)], [(None, ["said"])])


class OutputTest(unittest.TestCase):
    def test_an_ellipsis_is_anything_in_one_line_and_alone_any_lines(self):
        self.assertTrue(console.agrees(["took … ms", "…", "end"], ["took 12.5 ms", "a", "b", "end"]))
        self.assertTrue(console.agrees(["…", "end"], ["end"]))
        self.assertFalse(console.agrees(["took … ms"], ["took 1", "2 ms"]))

    def test_more_or_less_than_expected_differs(self):
        self.assertFalse(console.agrees(["a"], ["a", "b"]))
        self.assertFalse(console.agrees(["a", "b"], ["a"]))
        self.assertFalse(console.agrees([], ["a"]))

    def test_columns_may_be_wider_than_shown(self):
        self.assertTrue(console.agrees(["A  B", "1  … ms"], ["A   B ", "1   12.5 ms"]))
        self.assertFalse(console.agrees(["A  B"], ["A B"]))

    def test_nothing_in_an_expected_line_is_a_pattern(self):
        self.assertFalse(console.agrees(["a.c*"], ["abcc"]))
        self.assertTrue(console.agrees(["(a) [b] $"], ["(a) [b] $"]))

    def test_output_that_goes_on_is_compared_as_far_as_it_is_shown(self):
        self.assertEqual(console.begins(["a", "…", "c"], ["", "a", "b", "c", "d"]), 4)
        self.assertIsNone(console.begins(["a", "c"], ["a", "b"]))


class ScreenTest(unittest.TestCase):
    def shown(self, *pieces):
        screen = console.Screen()
        for piece in pieces:
            screen.feed(piece)
        return screen

    def test_a_line_that_is_redrawn_shows_its_last_text(self):
        self.assertEqual(self.shown("long text\r\x1b[Kshort\r\n").lines, ["short", ""])
        self.assertEqual(self.shown("ab\rc").lines, ["cb"])

    def test_a_table_that_is_redrawn_shows_its_last_text(self):
        self.assertEqual(self.shown("a\r\nb\r\n\x1b[2Fc\x1b[K\r\n\x1b[J").lines, ["c", ""])

    def test_pieces_of_a_sequence_are_put_together(self):
        self.assertEqual(self.shown("ab\r\x1b", "[", "Kc").lines, ["c"])

    def test_colours_leave_no_trace(self):
        self.assertEqual(self.shown("\x1b[1;32mgreen\x1b[0m").lines, ["green"])

    def test_a_prompt_tells_the_exit_status_and_is_not_shown(self):
        screen = self.shown("a\r\n\x1e", "13", "\x1eb")
        self.assertEqual(screen.lines, ["a", "b"])
        self.assertEqual(screen.prompts, [(1, 13)])


class QuoteTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = pathlib.Path(folder.name)
        (self.root / "a.cpp").write_text("int main() {\n    // [body]\n    f();\n\n      g();\n    // [end]\n}\n")

    def quoted(self, mark, block="```cpp\n```"):
        return quote.quoted(f"before\n<!-- quote: {mark} -->\n{block}\nafter", self.root)

    def test_a_region_is_quoted_without_its_indentation(self):
        text, findings = self.quoted("a.cpp [body]")
        self.assertIn("```cpp\nf();\n\n  g();\n```\nafter", text)
        self.assertEqual([line for line, _ in findings], [2])

    def test_a_file_is_quoted_without_the_marks_of_its_regions(self):
        text, _ = self.quoted("a.cpp")
        self.assertIn("```cpp\nint main() {\n    f();\n\n      g();\n}\n```", text)

    def test_what_is_equal_has_no_finding(self):
        text, _ = self.quoted("a.cpp [body]")
        self.assertEqual(quote.quoted(text, self.root), (text, []))

    def test_what_cannot_be_quoted_is_a_finding_and_changes_nothing(self):
        (self.root / "twice.cpp").write_text("// [a]\n// [end]\n// [a]\n// [end]\n")
        (self.root / "open.cpp").write_text("// [a]\n")
        for mark in ("b.cpp", "a.cpp [other]", "twice.cpp [a]", "open.cpp [a]", "a.cpp body"):
            with self.subTest(mark):
                text, findings = self.quoted(mark, "```cpp\nold\n```")
                self.assertEqual(len(findings), 1)
                self.assertIn("```cpp\nold\n```", text)
        text, findings = self.quoted("a.cpp", "no block")
        self.assertEqual(len(findings), 1)


if __name__ == "__main__":
    unittest.main()

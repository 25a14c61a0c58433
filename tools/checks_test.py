#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Shows that check_invariants.py, check_docs.py, check_site.py and check_style can fail: one small tree for each rule; and what
unless_stalled does."""
import argparse
import contextlib
import importlib.machinery
import importlib.util
import io
import json
import signal
import socket
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.dont_write_bytecode = True
sys.path.insert(0, str(Path(__file__).resolve().parent / "docs_site"))
import check_docs  # noqa: E402
import check_invariants  # noqa: E402
import check_site  # noqa: E402
import demo  # noqa: E402
import stage  # noqa: E402
import stalls  # noqa: E402

_loader = importlib.machinery.SourceFileLoader("unless_stalled", str(Path(__file__).with_name("unless_stalled")))
unless_stalled = importlib.util.module_from_spec(importlib.util.spec_from_loader(_loader.name, _loader))
_loader.exec_module(unless_stalled)

GPL = "// SPDX-License-Identifier: GPL-2.0-or-later\n"
MIT = "// SPDX-License-Identifier: MIT\n"


class TreeCase(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.root = Path(self.folder.name)
        (self.root / "src").mkdir()

    def tearDown(self):
        self.folder.cleanup()

    def write(self, path, text):
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")


class Demo(unittest.TestCase):
    def test_a_speed_that_no_laboratory_has_is_refused_before_anything_starts(self):
        for speed in ("0", "abc", "1000", "-1", "", "1e3", "0.001"):
            done = subprocess.run([Path(__file__).resolve().parent.parent / "demo", f"--speed={speed}"], stdin=subprocess.DEVNULL,
                                  capture_output=True, text=True, timeout=60, check=False)
            self.assertEqual(done.returncode, 2, done)
            self.assertEqual(done.stdout, "")
            self.assertIn(f"demo: expected --speed=N with a number N from 0.01 to 100, found '{speed}'\nfix: ", done.stderr)

    def test_the_usual_ports_are_taken_by_keep_alone_and_only_where_all_are_free(self):
        with socket.socket() as other:
            other.bind(("127.0.0.1", 0))
            other.listen()
            taken = other.getsockname()[1]
            self.assertFalse(demo.all_free([taken]))
            story = demo.Story.__new__(demo.Story)
            story.options = argparse.Namespace(keep=True, cluster=False)
            story.lab = argparse.Namespace(at={"client": "127.0.0.1:10410"})
            self.assertFalse(story.takes_usual([taken]))
            self.assertEqual(story.where(), "")
            story.lab.at["client"] = f"127.0.0.1:{taken}"
            self.assertIn(f"export AXON_SERVER=127.0.0.1:{taken}", story.where())
        self.assertTrue(story.takes_usual([taken]))
        story.options.keep = False
        self.assertFalse(story.takes_usual([taken]))


class UnlessStalled(TreeCase):
    """A command that leaves a mark each time, and succeeds from the third on."""

    def run_beside(self, longest, code=7):
        class Host:
            def __enter__(self):
                return self

            def longest(self, *_):
                return longest

            def __exit__(self, *_):
                pass
        marks = self.root / "marks"
        marks.write_text("", encoding="utf-8")
        with contextlib.redirect_stdout(io.StringIO()):
            code = unless_stalled.main(
                ["sh", "-c", f'echo >>"$0"; [ $(wc -l <"$0") -ge 3 ] || exit {code}', str(marks)], Host)
        return code, len(marks.read_text(encoding="utf-8"))

    def test_a_failure_stands(self):
        self.assertEqual(self.run_beside(0.0), (7, 1))

    def test_beside_a_stall_it_is_run_again(self):
        self.assertEqual(self.run_beside(0.2), (0, 3))

    def test_but_not_what_a_sanitizer_found_or_what_was_skipped(self):
        self.assertEqual(self.run_beside(0.2, code=66), (66, 1))
        self.assertEqual(self.run_beside(0.2, code=77), (77, 1))

    def test_nor_after_a_death_which_it_dies_too(self):
        done = subprocess.run([unless_stalled.__file__, "sh", "-c", "kill -SEGV $$"], check=False)
        self.assertEqual(done.returncode, -signal.SIGSEGV)

    def test_the_probe_sees_what_a_thread_waits(self):
        with stalls.Probe() as probe:
            pass
        probe.stalls = [(10.0, 10.3), (20.0, 20.2)]
        self.assertEqual([round(probe.longest(*window), 3) for window in ((), (15,), (10.2, 11), (11, 19))],
                         [0.3, 0.2, 0.3, 0])

    def test_of_a_suite_those_are_run_again_that_failed_beside_a_stall(self):
        tries = []

        class Shaky(unittest.TestCase):
            def test_good(self):
                tries.append("good")

            def test_shaky(self):
                tries.append("shaky")
                self.assertGreaterEqual(tries.count("shaky"), 3)

        class Host(contextlib.nullcontext):
            seen = 0.2

            def __init__(self):
                super().__init__(self)

            def longest(self, *_):
                return self.seen

        def run():
            tries.clear()
            runner = stalls.Runner(stream=io.StringIO())
            runner.probe_type = Host
            with contextlib.redirect_stdout(io.StringIO()):
                return runner.run(unittest.defaultTestLoader.loadTestsFromTestCase(Shaky)).wasSuccessful()

        self.assertTrue(run())
        self.assertEqual(tries, ["good", "shaky", "shaky", "shaky"])
        Host.seen = 0.0
        self.assertFalse(run())
        self.assertEqual(tries, ["good", "shaky"])


class Invariants(TreeCase):
    def found(self):
        return [f"{path}:{line}: {what}" for path, line, what, _ in check_invariants.findings(self.root)]

    def assertFound(self, start):
        self.assertTrue([f for f in self.found() if f.startswith(start)], f"{start!r} not in {self.found()}")

    def test_a_server_that_knows_what_carries_its_topic(self):
        self.write("src/front_end_server/servants.cpp", GPL + "// asks the TopicManager\n")
        self.write("src/entity_server/entity_server.cpp", GPL + '#include "transport/topics/storm_topics.hpp"\n')
        self.write("src/transport/ice/adapter.cpp", GPL + "#include <IceStorm/IceStorm.h>\n")
        self.write("src/transport/topics/storm_topics.cpp", GPL + "#include <IceStorm/IceStorm.h>\n")
        self.assertEqual(sorted(f.split(" ")[0] for f in self.found()),
                         ["src/entity_server/entity_server.cpp:2:", "src/front_end_server/servants.cpp:2:", "src/transport/ice/adapter.cpp:2:"])

    def test_a_clean_tree_has_no_findings(self):
        self.write("src/entity_server/entity_monitor.cpp", GPL + '#include "common/routed.hpp"\n// never sleep_for( here\n')
        self.write("src/common/routed.hpp", MIT + "#include <string>\n")
        self.write("src/entity_server/registry_servant.cpp", GPL + "#include <Ice/Ice.h>\n")
        self.write("src/entity_interfacer/axon/entity_interfacer.hpp", MIT + "#include <string>\n")
        self.assertEqual(self.found(), [])

    def test_protobuf_in_a_server_is_found(self):
        self.write("src/entity_server/entity_monitor.cpp", GPL + '#include "axon/task.pb.h"\n')
        self.assertFound("src/entity_server/entity_monitor.cpp:2: 1 ")

    def test_protobuf_in_a_server_is_found_behind_another_header(self):
        self.write("src/messages/text.hpp", MIT + '#include "axon/task.pb.h"\n')
        self.write("src/front_end_server/client_monitor.hpp", GPL + '#include "messages/text.hpp"\n')
        self.assertFound("src/front_end_server/client_monitor.hpp:2: 1 ")

    def test_a_server_that_links_protobuf_is_found(self):
        self.write("src/entity_server/CMakeLists.txt", "# SPDX-License-Identifier: GPL-2.0-or-later\naxon_library(x LINK axon_proto)\n")
        self.assertFound("src/entity_server/CMakeLists.txt:2: 1 ")

    def test_a_foreign_header_in_the_public_interface_of_the_entity_interfacer_is_found(self):
        self.write("src/entity_interfacer/axon/entity_interfacer.hpp", MIT + "#include <asio.hpp>\n")
        self.assertFound("src/entity_interfacer/axon/entity_interfacer.hpp:2: 2 ")

    def test_an_internal_header_in_the_public_interface_of_the_client_library_is_found(self):
        self.write("src/common/axon/refusal.hpp", MIT + "#include <string>\n")
        self.write("src/client/axon/client.hpp", GPL + '#include "axon/refusal.hpp"\n#include "common/routed.hpp"\n')
        self.assertFound("src/client/axon/client.hpp:3: 2 ")
        self.assertEqual(len(self.found()), 1)

    def test_a_sleeping_test_is_found_and_support_may_sleep(self):
        text = GPL + "void f() { std::this_thread::sleep_for(x); }\n"
        self.write("src/client/client_test.cpp", text)
        self.write("tests/e2e/kill.py", "# SPDX-License-Identifier: GPL-2.0-or-later\ntime.sleep(1)\n")
        self.write("tests/support/wait.hpp", text)
        self.assertFound("src/client/client_test.cpp:2: 6 ")
        self.assertFound("tests/e2e/kill.py:2: 6 ")
        self.assertEqual(len(self.found()), 2)

    def test_a_singleton_is_found(self):
        self.write("src/client/registry.hpp", GPL + "static Registry& instance() { static Registry r; return r; }\n")
        self.assertFound("src/client/registry.hpp:2: 7 ")

    def test_ice_outside_its_place_is_found(self):
        self.write("src/entity_manager/daemon.cpp", GPL + "#include <Ice/Ice.h>\n")
        self.write("robots/peoplebot/main.cpp", GPL + "#include <axon/commutil.h>\n")
        self.assertFound("src/entity_manager/daemon.cpp:2: 8 ")
        self.assertFound("robots/peoplebot/main.cpp:2: 8 ")

    def test_a_core_with_sockets_or_a_clock_of_its_own_is_found(self):
        self.write("src/entity_manager/core/entity_manager_core.cpp",
                   GPL + "#include <sys/socket.h>\nauto t = std::chrono::steady_clock::now();\n")
        self.assertFound("src/entity_manager/core/entity_manager_core.cpp:2: 10 ")
        self.assertFound("src/entity_manager/core/entity_manager_core.cpp:3: 10 ")

    def test_folders_that_include_each_other_are_found_whatever_is_in_between(self):
        self.write("src/a/a.hpp", GPL + '#include "b/b.hpp"\n#include "d/d.hpp"\n')
        self.write("src/b/b.hpp", GPL)
        self.write("src/b/other.cpp", GPL + '#include "b/c/c.hpp"\n')
        self.write("src/b/c/c.hpp", GPL + '#include "a/a.hpp"\n')
        self.write("src/d/d.hpp", GPL)
        self.write("src/d/d_test.cpp", GPL + '#include "a/a.hpp"\n')
        self.assertEqual([f.split(" ")[0] for f in self.found()],
                         ["src/a/a.hpp:2:", "src/b/c/c.hpp:2:", "src/b/other.cpp:2:"])

    def test_a_missing_or_wrong_licence_line_is_found(self):
        self.write("src/client/a.cpp", "#include <string>\n")
        self.write("src/common/b.hpp", GPL)
        self.write("demo", "#!/bin/sh\necho\n")
        self.assertFound("src/client/a.cpp:1: L ")
        self.assertFound("src/common/b.hpp:1: L ")
        self.assertFound("demo:2: L ")

    def test_an_mit_file_that_includes_gpl_code_is_found(self):
        self.write("src/client/a.hpp", GPL)
        self.write("src/messages/b.cpp", MIT + '#include "client/a.hpp"\n')
        self.assertFound("src/messages/b.cpp:2: L ")


class Docs(TreeCase):
    def found(self):
        return [f"{path}:{line}: {what}" for path, line, what, _ in check_docs.findings(self.root)]

    def test_what_exists_is_not_reported(self):
        self.write("src/client/a.hpp", GPL)
        self.write("src/client/b.hpp", GPL)
        self.write("docs/page.md", "# One, two!\n[x](../README.md#first-steps) `src/client/{a,b}.hpp` `src/*/a.hpp` `src/client/` `src/client/a`\n"
                                   "```\n`src/gone.hpp`\n```\n[here](#one-two) [web](https://example.org/x)\n")
        self.write("README.md", "## First steps\n")
        self.assertEqual(self.found(), [])

    def test_missing_paths_links_and_headings_are_reported(self):
        self.write("README.md", "# A\n`src/gone.hpp`\n[x](docs/gone.md)\n[y](#gone)\n`src/{README,gone}.md`\n")
        self.assertEqual([f.split(": ")[0] for f in self.found()], ["README.md:2", "README.md:3", "README.md:4", "README.md:5"])

    def test_other_code_is_not_taken_for_a_path(self):
        self.write("README.md", "`axon run PeopleBot Driving distance=1` `a/b` `build/dev/bin` `http://x/src/y`\n")
        self.assertEqual(self.found(), [])

    def test_what_comments_point_to_is_not_reported_where_it_exists(self):
        self.write("ARCHITECTURE.md", "# A\n## 2. Folders\n")
        self.write("docs/reference/page.md", "# One\n## Two words\n")
        self.write("docs/adr/0007-leases.md", "# Leases\n")
        self.write("src/a.hpp", GPL + '/// See docs/reference/page.md, "Two\n/// words"; page.md, and docs/adr, docs/reference/. (ADR\n/// 0007)\n'
                                      "// ARCHITECTURE.md, section 2; RFC 2104, section 5; thesis, chapter 5; appendix, section B\n")
        self.write("docs/run", "#!/bin/sh\n# docs/reference/page.md\n")
        self.assertEqual(self.found(), [])

    def test_comments_that_point_to_what_is_missing_are_reported(self):
        self.write("ARCHITECTURE.md", "# A\n## 2. Folders\n")
        self.write("docs/reference/page.md", "# One\n## Two words\n")
        self.write("src/a.hpp", GPL + "/// docs/reference/gone.md\nint a;  ///< gone.md\n// docs/folder/gone\n// ADR 0007\n"
                                      '/// So it is (page.md, "Two\n/// birds").\n// ARCHITECTURE.md, section 3\n// (architecture, section 6)\n')
        for path in ("api/a.proto", "api/a.ice", "tests/client.mjs"):
            self.write(path, "// docs/gone.md\n")
        for path in ("tests/a.py", "src/CMakeLists.txt"):
            self.write(path, "# docs/gone.md\n")
        self.write("tools/run", "#!/bin/sh\n# docs/gone.md\n")
        self.assertEqual(sorted(": ".join(f.split(": ")[:2]) for f in self.found()), [
            "api/a.ice:1: docs/gone.md is no page of the repository", "api/a.proto:1: docs/gone.md is no page of the repository",
            "src/CMakeLists.txt:1: docs/gone.md is no page of the repository",
            "src/a.hpp:2: docs/reference/gone.md is no page of the repository", "src/a.hpp:3: gone.md is no page of the repository",
            "src/a.hpp:4: docs/folder/gone is no page of the repository", "src/a.hpp:5: ADR 0007 does not exist",
            'src/a.hpp:6: page.md has no heading "Two birds"', "src/a.hpp:8: ARCHITECTURE.md has no section 3",
            "src/a.hpp:9: architecture, section 6",
            "tests/a.py:1: docs/gone.md is no page of the repository", "tests/client.mjs:1: docs/gone.md is no page of the repository",
            "tools/run:2: docs/gone.md is no page of the repository"])


class Style(TreeCase):
    """A checkout with one commit, of one source that is formatted and in which clang-tidy finds something."""

    FORMATTED = GPL + "#include <memory>\n\nint* nothing() { return 0; }\n"

    def setUp(self):
        super().setUp()
        self.write(".clang-format", "BasedOnStyle: Google\n")
        self.write(".clang-tidy", "Checks: '-*,modernize-use-nullptr'\n")
        self.write("src/a.cpp", self.FORMATTED)
        self.write("build/dev/compile_commands.json",
                   json.dumps([{"directory": str(self.root), "file": "src/a.cpp", "command": "c++ -std=c++20 -c src/a.cpp"}]))
        self.write(".gitignore", "/build/\n")
        self.git("init", "--quiet", "--initial-branch=main")
        self.commit()

    def git(self, *words):
        subprocess.run(["git", "-C", self.root, "-c", "user.name=x", "-c", "user.email=x@example.org", *words], check=True,
                       stdout=subprocess.DEVNULL)

    def commit(self):
        self.git("add", ".")
        self.git("commit", "--quiet", "--message", "x")

    def check(self, *words):
        done = subprocess.run([Path(__file__).with_name("check_style"), *words, "--root", self.root], capture_output=True, text=True,
                              timeout=120, check=False)
        return done.returncode, done.stdout, done.stderr

    def test_what_is_formatted_and_not_changed_passes(self):
        self.assertEqual(self.check(), (0, "", ""))

    def test_a_file_that_is_not_formatted_is_named_with_the_command_that_formats_it(self):
        self.write("src/a.cpp", self.FORMATTED.replace("{ return", "{return"))
        self.write("src/b.hpp", GPL + "int  b();\n")  # git does not know it yet
        code, said, _ = self.check("format")
        self.assertEqual(code, 1)
        self.assertEqual(said.splitlines()[:2], [f"src/{name}: not formatted by .clang-format" for name in ("a.cpp", "b.hpp")])
        command = said.splitlines()[2].removeprefix("fix: ").split()
        subprocess.run(command, cwd=self.root, check=True)
        self.assertEqual(self.check("format"), (0, "", ""))

    def test_what_was_unpacked_from_an_archive_is_judged_too(self):
        (self.root / ".git").rename(self.root / "git")
        self.write("src/b.hpp", GPL + "int  b();\n")
        code, said, _ = self.check("format")
        self.assertEqual((code, said.splitlines()[0]), (1, "src/b.hpp: not formatted by .clang-format"))
        code, said, _ = self.check("tidy")
        self.assertEqual(code, 0)
        self.assertIn("clang-tidy is left out", said)

    def test_clang_tidy_judges_changed_lines_only(self):
        self.write("src/a.cpp", self.FORMATTED + "int* something() { return 0; }\n")
        code, said, _ = self.check("tidy")
        self.assertEqual(code, 1)
        self.assertIn("src/a.cpp:5: ", said)
        self.assertIn("[modernize-use-nullptr]\nfix: ", said)
        self.assertNotIn("src/a.cpp:4: ", said)

    def test_and_files_that_git_does_not_know_yet(self):
        self.write("src/b.cpp", self.FORMATTED)
        code, said, _ = self.check("tidy")
        self.assertEqual(code, 1)
        self.assertIn("src/b.cpp:4: ", said)

    def test_what_was_committed_since_the_upstream_branch_is_changed(self):
        self.git("branch", "upstream")
        self.git("checkout", "--quiet", "-b", "work")
        self.git("branch", "--quiet", "--set-upstream-to=upstream")
        self.write("src/a.cpp", self.FORMATTED + "int* something() { return 0; }\n")
        self.commit()
        code, said, _ = self.check("tidy")
        self.assertEqual(code, 1)
        self.assertIn("src/a.cpp:5: ", said)
        self.git("branch", "--quiet", "--unset-upstream")
        code, said, _ = self.check("tidy")
        self.assertEqual(code, 1, "without an upstream branch, what differs from main")
        self.git("branch", "--quiet", "--force", "main", "HEAD")
        self.assertEqual(self.check("tidy"), (0, "", ""))

    def test_what_clang_tidy_cannot_read_is_no_success(self):
        self.write("src/a.cpp", GPL + '#include "generated.hpp"\n')
        code, said, _ = self.check("tidy")
        self.assertEqual(code, 1)
        self.assertIn("'generated.hpp' file not found", said)
        self.assertIn("fix: ", said)

    def test_without_the_commands_of_the_build_it_says_how_to_get_them(self):
        (self.root / "build/dev/compile_commands.json").unlink()
        self.write("src/a.cpp", self.FORMATTED + "\n")
        code, said, failed = self.check("tidy")
        self.assertEqual((code, said), (2, ""))
        self.assertIn("compile_commands.json\nfix: cmake --preset dev", failed)


class Site(TreeCase):
    def page(self, name, body):
        self.write(name, f"<html><head></head><body>{body}</body></html>")

    def found(self):
        return list(check_site.findings(self.root))

    def test_a_whole_site_is_silent(self):
        self.page("index.html", '<a href="docs/a.html#here">a</a> <a href="https://example.org/">elsewhere</a> <img src="data:image/png;base64,">')
        self.page("docs/a.html", '<h1 id="here">a</h1> <a href="../index.html">back</a> <a href="#here">up</a>')
        self.assertEqual(self.found(), [])

    def test_an_empty_folder_is_no_site(self):
        self.assertIn("there is no page", self.found()[0])

    def test_a_dead_link_and_a_missing_anchor_are_found(self):
        self.page("index.html", '<a href="gone.html">a</a> <a href="a.html#gone">b</a> <a href="#gone">c</a>')
        self.page("a.html", '<h1 id="here">a</h1>')
        found = self.found()
        self.assertEqual(len(found), 3, found)
        self.assertIn("index.html: gone.html leads to no file of the site", found[0])
        self.assertIn("a.html#gone names no heading", found[1])
        self.assertIn("#gone names no heading", found[2])

    def test_what_a_page_loads_over_the_network_is_found(self):
        for body in ('<script src="https://example.org/a.js"></script>', '<img src="//example.org/a.png">', '<p style="background: url(http://example.org/a.png)">',
                     '<style>@import "https://example.org/a.css";</style>', '<link rel="stylesheet" href="https://example.org/a.css">'):
            self.page("index.html", body)
            found = self.found()
            self.assertEqual(len(found), 1, (body, found))
            self.assertIn("over the network", found[0])
        self.page("index.html", "")
        self.write("a.css", "@font-face { src: url('https://example.org/a.woff'); }")
        self.assertIn("a.css: loads https://example.org/a.woff over the network", self.found()[0])

    def test_links_to_folders_and_files_lead_to_what_is_staged(self):
        self.write("a/README.md", "# a\n")
        self.write("LICENSES/MIT.txt", "free\n")
        self.write("src/a.hpp", "int a;\n")
        extra = {}
        text = stage.with_links(self.root.resolve(), self.root.resolve() / "README.md",
                                "[a](a) [a](a/) [l](LICENSES) [h](src/a.hpp) [p](b.md#c) [`x`](a) [w](https://example.org)\n```\n[f](a)\n```\n", extra)
        self.assertEqual(text, "[a](a/README.md) [a](a/README.md) [l](LICENSES/README.md) [h](src/a.hpp) [p](b.md#c) [`x`](a/README.md) "
                               "[w](https://example.org)\n```\n[f](a)\n```\n")
        self.assertEqual(sorted(str(one) for one in extra), ["LICENSES/README.md", "src/a.hpp"])


if __name__ == "__main__":
    unittest.main()

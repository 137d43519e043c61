# SPDX-License-Identifier: Apache-2.0
"""The section about Blender: what is concluded from its CSVs, and where it is written."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from bench import blender  # noqa: E402

FACTS = {"machine": "A", "threads": "2", "revision": "1", "load": "9.0", "size": "1920x1080"}


def frame(case: str, seconds: float, **columns: object) -> dict[str, str]:
    row = {
        "case": case,
        "run": 1,
        "frame": 9.0,
        "cpu": seconds,
        "finish": 0.01,
        "busy": 0.01,
        "denoised": "",
        "longest": "",
        **FACTS,
        **columns,
    }
    return {key: str(value) for key, value in row.items()}


def ours(case: str, seconds: float, busy: float) -> dict[str, str]:
    stages = {"set up": 0.01, "read": 0.2, "write": 0.02, "denoise": 1.0}
    return frame(case, seconds, finish=1.3, busy=busy, denoised=11, longest=0.03, **stages)


@pytest.fixture
def times() -> list[dict[str, str]]:
    return [
        frame("nothing", 2.0),
        frame("nothing", 4.0),
        frame("nothing", 3.0),
        frame("nothing, all passes", 5.0),
        frame(blender.CYCLES, 33.0),
        ours(blender.ALL_PASSES, 7.0, busy=0.3),
        ours(blender.COMBINED_ONLY, 4.0, busy=0.3),
    ]


def test_seconds_are_compared_with_the_same_passes(times):
    added = blender.added_seconds(times)
    assert added == {blender.CYCLES: 30.0, blender.ALL_PASSES: 2.0, blender.COMBINED_ONLY: 1.0}


def test_what_cycles_does_itself_is_not_the_add_ons(times):
    seconds = blender.stage_row(times, blender.ALL_PASSES)
    assert seconds["added"] == pytest.approx(1.3 - 1.0 - 0.01)
    assert seconds["rest"] == pytest.approx(0.29 - 0.23)
    assert seconds["busy"] == pytest.approx(0.29)


def test_levels_are_in_order_of_work():
    names = ["Quell high, a", "Quell fast, b", "Quell balanced, a", "Quell fast, a"]
    in_order = sorted((Path(name) for name in names), key=blender.by_level)
    assert [path.name for path in in_order] == [names[3], names[1], names[2], names[0]]


def test_the_section_takes_its_place_in_the_page(times, tmp_path):
    errors = [
        {"scene": scene, "spp": spp, "method": method, "rel_mse": "0.25"}
        for scene in ("a", "b")
        for spp in ("4", "16")
        for method in ("noisy", blender.CYCLES, blender.ALL_PASSES)
    ]
    page = tmp_path / "page.md"
    page.write_text(f"before\n{blender.BEGIN}\nold\n{blender.END}\nafter\n")
    for _ in range(2):
        blender.put_section(page, blender.section(errors, times))
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert text.count("| noisy | 0.25 | 0.25 |  |") == 1
    assert f"| {blender.CYCLES} | 0.25 | 0.25 | 30 |" in text
    assert "at most 0.03 s" in text
    # At most 0.6 is reached, at most 0.1 is not.
    assert text.count("| yes |") == 1 and text.count("| **no** |") == 1


def test_aims_are_for_one_size(times):
    for row in times:
        row["size"] = "854x480"
    assert "| yes |" not in blender.stage_table(times) and "| **no** |" not in blender.stage_table(times)


def test_a_page_without_marks_is_left_alone(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("text")
    with pytest.raises(SystemExit):
        blender.put_section(page, "section")
    assert page.read_text() == "text"

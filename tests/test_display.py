"""Public values show themselves: one line in a console, a table in a notebook."""

import math
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import pytest

import turtlelog as tl
from turtlelog.display import (
    NamedValues,
    cut_name,
    format_html,
    format_number,
    format_range,
    format_short,
    parse_utc,
)
from turtlelog.explain.answers import ValueSet
from turtlelog.explain.scenario_from_log import Certainty
from turtlelog.laws.loading import LAWS

FILE: Final = "recordings/paper/kp10.mcap"
RUN: Final = tl.read_recording(FILE)
OTHER: Final = tl.read_recording("recordings/paper/kp4.mcap")
LONGEST: Final = 80
"""Characters: a line of a terminal."""

SPEC: Final = 'format = 1\n[checks.end]\nexpect = "run.duration > 1"'

VALUES: Final[dict[str, tuple[Callable[[], Any], str]]] = {
    "run": (lambda: RUN, "<Run paper-kp10: 770 samples, 12.6 s, standstill>"),
    "scenario": (
        lambda: tl.load_scenario("paper-kp10"),
        "<Scenario paper-kp10: sequential-p, goal (2, 10) m>",
    ),
    "metric": (
        lambda: tl.measure_run(RUN)["final.position_error"],
        "<Metric final.position_error: 0.10673 m>",
    ),
    "missing metric": (
        lambda: tl.measure_run(RUN)["final.goal_heading_error"],
        "<Metric final.goal_heading_error: absent (the goal asks for no heading)>",
    ),
    "metrics": (lambda: tl.measure_run(RUN), "<Metrics: 135, of which 127 have a value>"),
    "METRICS": (lambda: tl.METRICS, "metrics: <loop>.duration, "),
    "SIGNALS": (lambda: tl.SIGNALS, "signals: x, y, heading, speed, ...>"),
    "FIGURES": (lambda: tl.draw.FIGURES, "figures: plant, "),
    "LAWS": (lambda: LAWS, f"<{len(LAWS)} laws: sequential-p"),
    "kind of metric": (
        lambda: tl.METRICS["run.duration"],
        "<MetricKind [s]: Time from the first sample",
    ),
    "kind of signal": (
        lambda: tl.SIGNALS["x"],
        "<SignalKind [m]: Coordinate x in the world frame.>",
    ),
    "kind of figure": (
        lambda: tl.draw.FIGURES["plant"],
        "<FigureKind: Impulse, step and ramp response",
    ),
    "signal": (lambda: tl.read_signal(RUN, "x"), "<Signal x: 793 values in m, "),
    "comparison": (lambda: tl.compare_runs(RUN, OTHER), "<RunComparison of paper-kp4: "),
    "summary": (lambda: tl.summarise_run(RUN), "<RunSummary paper-kp10: 135 metrics, standstill>"),
    "table": (
        lambda: tl.tabulate_runs([tl.summarise_run(RUN)]),
        "<Table 1 run: 1 row of 7 columns>",
    ),
    "identification": (
        lambda: tl.identify_run(RUN),
        "<Identification of paper-kp10: 27 of 29 values",
    ),
    "attribution": (lambda: tl.attribute_run(RUN), "0.1067 m: queue 0.05108, pause 0.05057>"),
    "plant": (
        lambda: tl.replay_plant(RUN),
        "<PlantReplay of paper-kp10: 793 compared, no difference>",
    ),
    "law": (lambda: tl.replay_law(RUN), "<LawReplay of paper-kp10: 770 compared, no difference>"),
    "loop": (
        lambda: tl.replay_loop(RUN, tl.load_scenario("paper-kp4")),
        "<LoopReplay of paper-kp10: 681 compared, first differs in ",
    ),
    "info": (lambda: tl.read_info(FILE), "kp10.mcap: 6 topics, 12.7 s, complete>"),
    "topic": (
        lambda: tl.read_columns(FILE)["/turtle1/pose"],
        "<TopicColumns /turtle1/pose: 793 of turtlesim/msg/Pose: x, y, ",
    ),
    "expression": (
        lambda: tl.expressions.parse_expression("x > 1 and y < 2"),
        "<Expression x > 1 and y < 2>",
    ),
    "formula": (
        lambda: tl.check.check_run(RUN, "always(abs(cross_track) <= 0.05)"),
        "<FormulaResult always(abs(cross_track) <= 0.05): violated, margin -",
    ),
    "check": (
        lambda: next(
            iter(
                tl.check_runs(
                    tl.parse_spec('format = 1\n[checks.end]\nexpect = "run.duration > 1"'),
                    [("f", RUN)],
                )
            )
        ),
        "end of f: ",
    ),
    "spec": (
        lambda: tl.parse_spec(SPEC),
        "<Spec specification: 1 check, 0 tolerances>",
    ),
    "recording": (lambda: tl.Recording(FILE), "<recording recordings/paper/kp10.mcap>"),
}


@pytest.mark.parametrize("name", VALUES)
def test_public_value_is_one_line_that_says_what_it_is(name: str) -> None:
    build, expected = VALUES[name]
    value = build()
    assert expected in repr(value)
    assert "\n" not in repr(value)
    assert " at 0x" not in repr(value)
    assert len(repr(value)) <= LONGEST


@pytest.mark.parametrize(
    ("name", "texts"),
    [
        (
            "run",
            ["missed the goal by 0.107 m (allowed: 0.00669 m) after 12.6 s", "770 samples", "<svg"],
        ),
        ("scenario", ["sequential-p to (2, 10) m", "law.kp_linear", "All 25 keys"]),
        ("signal", ["793 values in m, 2.", "<svg"]),
        ("loop", ["first differs in", "largest difference"]),
        ("law", ["770 compared, no difference."]),
        ("metrics", ["<td", "final.position_error", "0.10673", "the goal asks for no heading"]),
        ("summary", ["rotate.overshoot", "1.0076"]),
        ("table", ['<th style="text-align:right">Kp [1/s]</th>', 'left">run</th>', "paper-kp10"]),
        ("comparison", ["largest difference", "cross_track"]),
        ("identification", ["loop.start_backlog", "reproduces all 770 samples"]),
        ("attribution", ["<strong>final.position_error is 0.1067 m: queue and pause add"]),
    ],
)
def test_value_is_a_table_in_a_notebook(name: str, texts: list[str]) -> None:
    html = VALUES[name][0]()._repr_html_()
    assert html.startswith('<div class="turtlelog">\n<p><strong>')
    assert [text for text in texts if text not in html] == []


def test_metrics_in_a_notebook_begin_with_those_of_the_command() -> None:
    first, every = tl.measure_run(RUN)._repr_html_().split("<details>")
    assert first.count("<tr>") - 1 == len(tl.measure.list_essential_metrics(RUN)) == 22
    assert "All 135 metrics" in every
    assert every.count("<tr>") - 1 == 135


def test_check_of_a_recording_is_a_table_in_a_notebook() -> None:
    outcome = tl.Recording(FILE).holds("run.duration < 1")
    for text in ("<table", "FAIL", "12.6", "run.duration &lt; 1"):
        assert text in outcome._repr_html_()


def test_angles_of_a_comparison_are_in_degrees_in_a_notebook() -> None:
    comparison = tl.compare_runs(RUN, OTHER)
    (heading,) = (found for found in comparison.signals if found.signal == "heading")
    cells = f'deg</td><td style="text-align:right">{math.degrees(heading.largest):.5g}</td>'
    assert cells in comparison._repr_html_()
    assert ">rad<" not in comparison._repr_html_()


def test_value_that_several_settings_fit_is_not_called_known() -> None:
    found = tl.identify_run(RUN)
    key = "law.kp_linear"
    for certainty, known in ((Certainty.FITTED, 27), (Certainty.AMBIGUOUS, 26)):
        changed = replace(found.findings[key], certainty=certainty)
        again = replace(found, findings={**found.findings, key: changed})
        assert f"{known} of 29 values known" in repr(again)


def test_attribution_without_shares_does_not_say_that_no_effect_acts() -> None:
    found = replace(tl.attribute_run(RUN), contributions=())
    assert repr(found).endswith("0.1067 m: no effect changes it>")
    for why in ({"withheld": "the log differs"}, {"without_value": (ValueSet(causes=("a",)),)}):
        assert repr(replace(found, **why)).endswith("0.1067 m: no contributions>")


@pytest.mark.parametrize(
    ("most", "tail", "mark", "expected"),
    [
        (10, 0, "...", "abcdefghij"),
        (9, 0, "...", "abcdef..."),
        (9, 2, "...", "abcd...ij"),
        (9, 4, "…", "abcd…ghij"),
    ],
)
def test_long_name_is_cut_at_its_end_or_before_its_tail(
    most: int, tail: int, mark: str, expected: str
) -> None:
    assert cut_name("abcdefghij", most, tail=tail, mark=mark) == expected


def test_counts_of_one_are_singular() -> None:
    assert ": 1 sample, " in repr(RUN.slice(0, 0))
    assert ": 2 samples, " in repr(RUN.slice(0, 0.016))


def test_html_is_escaped_and_numbers_stand_on_the_right() -> None:
    html = format_html([("<i>", 0.123456, None, True)], heads=("<b>", "", "", ""), title="a & b")
    assert "<i>" not in html
    assert "<b>" not in html
    assert "a &amp; b" in html
    assert '<td style="text-align:right">0.12346</td>' in html
    left = "text-align:left;white-space:nowrap"
    assert f'<td style="{left}"></td><td style="{left}">True</td>' in html


def test_named_values_are_a_mapping_that_nobody_changes() -> None:
    values: Any = NamedValues("metric", {"a": 1, "b": 2})
    assert dict(values) == {"a": 1, "b": 2}
    assert (list(values), len(values), "a" in values) == (["a", "b"], 2, True)
    assert pickle.loads(pickle.dumps(values)) == values
    with pytest.raises(TypeError):
        values["a"] = 3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1970-01-01T00:00:01Z", 1_000_000_000),
        ("1970-01-01T00:00:01", 1_000_000_000),
        ("1970-01-01T01:00:01+01:00", 1_000_000_000),
        ("1970-01-01T00:00:00.000000001Z", 1),
        ("1970-01-01T00:00:00.5", 500_000_000),
        ("2026-01-22T12:20:06.020038", 1_769_084_406_020_038_000),
    ],
)
def test_timestamps_are_read_to_the_nanosecond(text: str, expected: int) -> None:
    assert parse_utc(text) == expected


@pytest.mark.parametrize("text", ["", "yesterday", "123 ns", "9999-01-01T00:00:00", "0001-01-01"])
def test_what_is_no_usable_time_is_none(text: str) -> None:
    assert parse_utc(text) is None


def test_a_name_of_24_letters_is_one_line_and_a_longer_one_or_a_sentence_may_wrap() -> None:
    html = format_html([["paper-kp10", "n" * 24, "n" * 25, "no limit"]])
    cells = re.findall(r'<td style="([^"]*)">([^<]*)<', html)
    assert [text for style, text in cells if "nowrap" in style] == ["paper-kp10", "n" * 24]


@pytest.mark.parametrize(
    ("ends", "unit", "texts"),
    [
        ((0.00101, 0.107), "m", ("0.00101 m", "0.107 m")),
        ((0.00101, 0.00852), "m", ("1.01 mm", "8.52 mm")),
        ((0.0, 0.002), "m", ("0 m", "0.002 m")),
        ((11.2, 20.5), "s", ("11.2 s", "20.5 s")),
        ((21.945, 21.955), "s", ("22 s", "22 s")),  # closer than 0.05 %
        ((21.944, 21.956), "s", ("21.9 s", "22 s")),
        ((9e-10, 0.0593), "m", ("below 1e-6 mm", "0.0593 m")),
        ((1.1e-9, 0.0593), "m", ("1.1e-09 m", "0.0593 m")),
    ],
)
def test_both_ends_of_a_range_have_one_unit(
    ends: tuple[float, float], unit: str, texts: tuple[str, str]
) -> None:
    assert format_range(*ends, unit) == texts


@pytest.mark.parametrize(
    ("number", "unit", "text"),
    [
        (999.4, "ms", "999 ms"),
        (999.5, "ms", "1000 ms"),
        (9e-10, "m", "below 1e-6 mm"),
        (1.1e-9, "m", "1.1e-06 mm"),
        (-9e-10, "rad", "below 1e-7 deg"),
        (0.0, "m", "0 m"),
        (9e-10, "s", "9e-10 s"),
    ],
)
def test_short_numbers_hide_rounding_and_show_whole_thousands(
    number: float, unit: str, text: str
) -> None:
    assert format_short(number, unit) == text


@pytest.mark.parametrize(("number", "text"), [(-0.0, "0 %"), (0.0, "0 %"), (-0.5, "-0.5 %")])
def test_a_zero_is_printed_without_a_sign(number: float, text: str) -> None:
    assert format_number(number, "%") == text

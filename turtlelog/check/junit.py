"""Verdicts on recordings as JUnit XML."""

from collections.abc import Sequence
from typing import Final
from xml.etree import ElementTree as Xml

from turtlelog.check.judged_files import CheckedFile
from turtlelog.check.result import CheckResult, Verdict, describe_result
from turtlelog.escapes import escape_controls

_NO_XML: Final = {0xFFFE: r"\ufffe", 0xFFFF: r"\uffff"}


def format_junit(files: Sequence[CheckedFile]) -> str:
    """Return results as JUnit XML, with the times of the files."""
    took_s = sum(found.took_s for found in files)
    counts = _count([result for found in files for result in found.results])
    root = Xml.Element("testsuites", {**counts, "time": f"{took_s:.3f}"})
    root.set("name", "turtlelog check")
    for found in files:
        root.append(_build_suite(found))
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _build_suite(found: CheckedFile) -> Xml.Element:
    suite = Xml.Element("testsuite", {"name": _clean(found.file), **_count(found.results)})
    suite.set("time", f"{found.took_s:.3f}")
    if found.started is not None:
        suite.set("timestamp", found.started.isoformat(timespec="seconds"))
    if found.metrics:
        properties = Xml.SubElement(suite, "properties")
        for metric in found.metrics.values():
            value = metric.status.value if metric.value is None else repr(metric.value)
            name = metric.id if metric.unit == "1" else f"{metric.id} [{metric.unit}]"
            Xml.SubElement(properties, "property", {"name": name, "value": value})
    each_s = found.each_s or (0.0,) * len(found.results)
    for result, took_s in zip(found.results, each_s, strict=True):
        suite.append(_build_case(result, found.details.get(result.check, ""), took_s))
    return suite


def _build_case(result: CheckResult, details: str, took_s: float) -> Xml.Element:
    names = {"name": _clean(result.check), "classname": _clean(result.file)}
    case = Xml.Element("testcase", {**names, "time": f"{took_s:.3f}"})
    if result.verdict is Verdict.SKIPPED:
        Xml.SubElement(case, "skipped", {"message": _clean(result.reason)})
    if result.verdict is Verdict.FAIL:
        message = _clean(describe_result(result))
        failure = Xml.SubElement(case, "failure", {"message": message, "type": "check"})
        failure.text = _clean(details or message)
    return case


def _count(results: Sequence[CheckResult]) -> dict[str, str]:
    verdicts = [result.verdict for result in results]
    return {
        "tests": str(len(verdicts)),
        "failures": str(verdicts.count(Verdict.FAIL)),
        "skipped": str(verdicts.count(Verdict.SKIPPED)),
        "errors": "0",
    }


def _clean(text: str) -> str:
    """Return text with escapes for characters that XML cannot contain or that are invisible."""
    return escape_controls(text, keep="\n").translate(_NO_XML)

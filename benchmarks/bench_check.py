"""Checking formulas over a million samples, against SciPy's filters and rtamt's monitor.

The signal is a random walk, sampled every 16 ms, and once at uneven times. The bound is to read
every value once: its least. SciPy's filter knows even samples only, and gives no violations.
"""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

import turtlelog as tl
from benchmarks.table import Cost, Row, run_alone, time_calls

try:
    import rtamt
except ImportError:  # it wants an older Python than some that turtlelog runs on
    rtamt = None

SAMPLES = 1_000_000
PART = 5_000  # of them, that rtamt reads: it takes long enough
PERIOD_NS = 16_000_000
WINDOWS_S = (5, 5000)
MONITORED = {
    "eventually, uneven": "always(eventually[0, 5](x > 0.5))",
    "nested": "always(x > 0.5 implies eventually[0, 5](always[0, 1](x < 0.5)))",
    "until[0, 5]": "always((x > 0.5) until[0, 5] (x < 0.5))",
}
"""Formulas that are checked beside rtamt."""


def monitor(text: str, time_ns: NDArray[np.int64], values: NDArray[np.float64]) -> None:
    """Compute the margin of a formula of one signal with rtamt."""
    specification = rtamt.StlDenseTimeSpecification()
    for name in ("x", "margin"):
        specification.declare_var(name, "float")
    specification.spec = f"margin = {text.replace(', ', ':').replace('implies', '->')}"
    specification.parse()
    times_s = ((time_ns - time_ns[0]) / 1e9).tolist()
    specification.evaluate(["x", [list(row) for row in zip(times_s, values, strict=True)]])


def measure(share: float = 1.0) -> Iterator[Row]:
    samples, part = round(SAMPLES * share), round(PART * share)
    rng = np.random.default_rng(0)
    values = np.cumsum(rng.normal(size=samples)) / 100.0
    even_ns = np.arange(samples) * PERIOD_NS
    uneven_ns = np.cumsum(rng.integers(1, 2 * PERIOD_NS, samples))

    def compare(job: str, text: str, name: str, peer: Callable[[], object]) -> Row:
        formula = tl.expressions.parse_expression(text)
        signals = {"x": (uneven_ns if job.endswith("uneven") else even_ns, values)}
        check, other, bound = time_calls(
            lambda: tl.check_formula(signals, formula), peer, values.min, repeats=3
        )
        scaled = other * samples / part if name == "rtamt" else other
        cost = None if name == "rtamt" and rtamt is None else Cost(name, scaled)
        return Row(job=f"check {job}", value=check, peer=cost, bound=Cost("read once", bound))

    yield compare("x > c", "always(x > 0.5)", "numpy min", lambda: (values - 0.5).min())
    for window_s in WINDOWS_S:
        width = min(window_s * 10**9 // PERIOD_NS + 1, samples)
        yield compare(
            f"eventually[0, {window_s}]",
            f"always(eventually[0, {window_s}](x > 0.5))",
            "scipy filter",
            lambda: maximum_filter1d(values - 0.5, width).min(),  # noqa: B023 (called at once)
        )
    for job, text in MONITORED.items():
        time_ns = uneven_ns if job.endswith("uneven") else even_ns

        def run_peer(text: str = text, time_ns: NDArray[np.int64] = time_ns) -> None:
            if rtamt is not None:
                monitor(text, time_ns[:part], values[:part])

        yield compare(job, text, "rtamt", run_peer)


if __name__ == "__main__":
    run_alone(measure)

"""Which gain is best? At eight gains the program as built, and the loop of the textbook.

Run: python examples/best_gain.py
"""

import turtlelog as tl

GAINS = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)
METRICS = ("run.duration", "rotate.settling_time", "rotate.overshoot", "final.position_error")
ACCURATE_ENOUGH = "final.position_error < 0.01"  # m


def simulate_gain(preset: str, kp: float) -> tl.compare.RunSummary:
    changes = {"name": f"{preset} {kp:g}", "law.kp_linear": kp, "law.kp_angular": kp}
    return tl.summarise_run(
        tl.simulate_run(tl.override_scenario(tl.load_scenario(preset), changes))
    )


for preset in ("paper", "textbook"):
    summaries = [simulate_gain(preset, kp) for kp in GAINS]
    table = tl.tabulate_runs(summaries, only=METRICS)
    print(tl.draw.format_table(table), end="")
    chosen, _notes = tl.compare.select_runs(summaries, ACCURATE_ENOUGH)
    best = tl.compare.sort_runs(chosen, "run.duration")[0]
    print(f"\nFastest of {len(chosen)} with {ACCURATE_ENOUGH}: {best.name}\n")

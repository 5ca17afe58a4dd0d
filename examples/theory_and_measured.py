"""Theory beside measurement: settling of the heading at the paper's four gains.

Run: python examples/theory_and_measured.py
"""

import math

import turtlelog as tl

TURN_RAD, LIMIT_RAD_S, PERIOD_S = 2.2428, 1.0, 0.016

print("  Kp   4 tau  clipped  measured  dead time  no overshoot up to  overshoot")
for kp in (1.0, 2.0, 4.0, 10.0):
    measured = tl.measure_run(tl.simulate_run(tl.load_scenario(f"paper-kp{kp:g}")))
    ticks = round((measured["rotate.dead_time"].value or math.nan) / PERIOD_S)
    print(
        f"{kp:4g}"
        f"{tl.theory.compute_settling_time(kp):8.2f}"
        f"{tl.theory.compute_saturated_settling_time(kp, step=TURN_RAD, limit=LIMIT_RAD_S):9.2f}"
        f"{measured['rotate.settling_time'].value:10.2f}"
        f"{ticks:5d} ticks"
        f"{tl.theory.compute_overshoot_gain(PERIOD_S, ticks):20.2f}"
        f"{measured['rotate.overshoot'].value:9.2f} %"
    )

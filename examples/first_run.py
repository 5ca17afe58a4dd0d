"""Simulate, record, read back, measure: the whole way in ten lines."""

import turtlelog as tl

scenario = tl.load_scenario("paper-kp10")
tl.write_recording(tl.simulate_run(scenario), "kp10.mcap")

run = tl.read_recording("kp10.mcap")
metrics = tl.measure_run(run)
for name in ("rotate.overshoot", "rotate.settling_time", "final.position_error"):
    print(f"{name} = {metrics[name].value:.4f} {metrics[name].unit}")

# What if the newest command had won, instead of waiting in the queue?
changed = tl.override_scenario(scenario, {"loop.queue_policy": "newest", "law.pause_ticks": 0})
better = tl.measure_run(tl.simulate_run(changed))["final.position_error"]
print(f"without queue and pause: final.position_error = {better.value:.4f} {better.unit}")

import turtlelog as tl
from turtlelog.compare import summarise_run, tabulate_runs
from turtlelog.draw.written_tables import document_runs, format_markdown


def test_beside_pictures_runs_show_first_where_they_ended() -> None:
    runs = [tl.read_recording(f"recordings/paper/kp{kp}.mcap") for kp in (2, 10)]
    text = document_runs(runs)["Side by side"]
    heads = next(line for line in text.splitlines() if line.startswith("| run"))
    assert heads.split(" | ")[1:4] == [
        "Kp [1/s]",
        "final.position_error [m]",
        "final.heading_error [deg]",
    ]
    # What stands in a column moves with it, and so does its mark.
    whole = format_markdown(tabulate_runs([summarise_run(run) for run in runs]))
    for ours, others in zip(text.splitlines(), whole.splitlines(), strict=True):
        assert sorted(ours.split(" | ")) == sorted(others.split(" | ")) or ours[0] != "|"
    assert "**0.0010113**" in text

"""`palpate sensor check`: JSON, a page, and an exit code that says how it is."""

import json


def test_a_simulated_array_is_well(palpate, tmp_path):
    page = tmp_path / "health.html"
    done = palpate(
        *("sensor", "check", "--sensor", "sim:bar10?gap=9000&rate=100"),
        *("--seconds", "1", "--report", page, "--json"),
    )
    found = json.loads(done.stdout)
    # The machine may hold frames up; nothing else can be wrong with it.
    held_up = [s for s in found["findings"] if "One frame" in s or "lost" in s]
    assert found["findings"] == held_up
    assert done.returncode == (1 if held_up else 0)
    assert found["figures"]["frames"] > 24
    assert "drift" in page.read_text()
    assert "http" not in page.read_text().replace("http-equiv", "")


def test_a_touched_sensor_is_not_well(palpate):
    done = palpate(
        "sensor", "check", "--sensor", "sim:bar10?rate=100", "--seconds", "1"
    )
    assert done.returncode == 1
    assert "touch" in done.stdout.splitlines()[0]


def test_reports_and_seconds_are_checked(palpate, tmp_path):
    sensor = ("sensor", "check", "--sensor", "sim:bar10")
    assert "must end in .html" in palpate(*sensor, "--report", "x.pdf").stderr
    assert "seconds must be" in palpate(*sensor, "--seconds", "0").stderr

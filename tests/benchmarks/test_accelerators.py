"""The script that compares an accelerator with the CPU runs, here on what there is; no time counts."""

import json

import gpu
import numpy as np
import pytest


@pytest.mark.benchmark
def test_accelerator():
    gpu.main([])


@pytest.mark.full
def test_a_small_run_is_written_and_printed(tmp_path, capsys):
    words = ["--lanes", "2", "--periods", "1", "--rounds", "1", "--methods", "rk4 400"]
    gpu.main(words, tmp_path / "gpu.json")
    found = json.loads((tmp_path / "gpu.json").read_text())
    ways = ("in chunks", "in one call")
    names = {f"{case}, rk4 400, 2 lanes, {way}" for case in ("table1", "fig09_best") for way in ways}
    assert set(found["cpu"]["us"]) == names
    assert all(us > 0 for us in found["cpu"]["us"].values())
    printed = capsys.readouterr().out
    assert all(name in printed for name in [*names, found["cpu"]["device"]])


def test_platforms_are_compared_by_their_motions(monkeypatch, capsys):
    # As if there were an accelerator whose motions are off by a relative 1e-6.
    ends = {"a": np.ones((4, 12))}

    def in_process(words, platform):
        size = 1.0 if platform == "cpu" else 1.0 + 1e-6
        return {"platform": platform or "tpu", "device": "one", "us": {"a": 2.0}}, {"a": ends["a"] * size}

    monkeypatch.setattr(gpu, "in_process", in_process)
    found = gpu.compared([])
    assert set(found) == {"cpu", "tpu", "median difference of motions"}
    assert found["median difference of motions"]["a"] == pytest.approx(1e-6)
    gpu.print_table(found)
    assert "apart" in capsys.readouterr().out

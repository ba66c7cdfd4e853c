"""What a type checker must see of the public names. Checked by mypy, imported by nobody."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import assert_type

    from matplotlib.figure import Figure

    import fiohost

    def _a_bench() -> None:
        with fiohost.connect("sim") as bench:
            assert_type(bench, fiohost.Bench)
            bench.duty = 40
            bench.sleep(1)
            assert_type(bench.angle_deg, float)
            assert_type(bench.log, fiohost.Log)
            assert_type(bench.run("staircase"), fiohost.Log)

    def _logs_and_models(log: fiohost.Log) -> None:
        assert_type(fiohost.read_log("a.csv"), fiohost.Log)
        assert_type(fiohost.identify("a.csv"), fiohost.Identification)
        assert_type(fiohost.identify([log, "b.csv"]).model, fiohost.Model)
        assert_type(fiohost.simulate(log, "linear"), fiohost.Simulation)
        assert_type(fiohost.simulate([1.0, 2.0]).error_rms, float | None)
        assert_type(fiohost.design("linear").settings, fiohost.ControlSettings)
        _: Figure = fiohost.plot(log)

    def _a_diagnosis() -> None:
        found = fiohost.diagnose(["a.csv", "b.csv"], "c.csv", "linear+coulomb_friction")
        assert_type(found, fiohost.Diagnosis)
        assert_type(found.summary(), str)
        assert_type(found.to_json(), str)
        assert_type(found.effects, list[str])
        assert_type(found.result["steps"][0]["effect"], str)
        assert_type(found.result["after"]["train"]["free_run_rms"], float)

"""A model as an FMU (FMI 3.0, co-simulation), built by pythonfmu3: input duty, outputs angle and speed.

The whole model is in it, every effect too. The FMU calls fiohost: it runs where a Python with fiohost is the one that
the simulating program finds.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from fiohost.errors import ConfigError, FiohostError
from fiohost.files import write_output
from fiohost.motor.model import Model

SCRIPT = '''\
"""A motor's model in an FMU, written by fiohost."""

from pathlib import Path

from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Variability, Float64


class {name}(Fmi3Slave):
    author = "fiohost"
    description = "{expression}"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        from fiohost.export.stepper import Stepper

        self.time = 0.0
        self.duty_pct = 0.0
        self.angle_deg = 0.0
        self.speed_deg_s = 0.0
        self._stepper = Stepper(Path(self.resources) / "model.toml")
        self.register_variable(
            Float64("time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous)
        )
        self.register_variable(Float64("duty_pct", causality=Fmi3Causality.input, start=0.0))
        self.register_variable(Float64("angle_deg", causality=Fmi3Causality.output))
        self.register_variable(Float64("speed_deg_s", causality=Fmi3Causality.output))

    def do_step(self, current_time, step_size):
        self.angle_deg, self.speed_deg_s = self._stepper.step(self.duty_pct, step_size)
        return True
'''


def write_fmu(model: Model, path: Path) -> Path:
    """Build the FMU and write it to *path*, whose stem names it. Raises ConfigError without the library."""
    name = path.stem
    if not name.isidentifier():
        raise ConfigError(f"{path}: the name of an FMU is made of letters, digits and underscores")
    try:
        from pythonfmu3.builder import FmuBuilder
    except ImportError:
        raise ConfigError("an FMU needs pythonfmu3: pip install 'fiohost[export]'") from None
    with tempfile.TemporaryDirectory() as folder:
        script, kept = Path(folder) / f"{name}.py", Path(folder) / "model.toml"
        script.write_text(SCRIPT.format(name=name, expression=model.expression), encoding="utf-8")
        model.write(kept, f"the model of {path.name}")
        try:
            built = Path(FmuBuilder.build_FMU(script, dest=folder, project_files=[kept]))
        except Exception as exc:
            raise FiohostError(f"pythonfmu3 cannot build {path}: {' '.join(str(exc).split())[:300]}") from exc
        return write_output(path, built.read_bytes())

"""Types of a diagnosis as JSON, schema ``fiohost.diagnosis/1``: what an editor offers behind ``Diagnosis.result``."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict


class ParameterResult(TypedDict):
    """One value in ``unit`` with its 95 % interval; text, without interval, where it is a choice."""

    value: float | str
    unit: str
    ci95: tuple[float | None, float | None] | None
    identifiable: bool
    at_bound: bool


class ErrorResult(TypedDict):
    """Errors of a model on logs; rms in the output's unit, of whole runs and of windows of 1 s."""

    free_run_rms: float
    window_rms: float
    bin_violation_pct: float
    fit_pct: float
    samples: int


class PairOfErrors(TypedDict):
    """Of the training logs, and of the logs held out where there are any."""

    train: ErrorResult
    holdout: ErrorResult | None


# One key is a word of Python.
FloorResult = TypedDict(
    "FloorResult",
    {
        "train": ErrorResult,
        "holdout": ErrorResult | None,
        "from": Literal["replicas", "noise", "repeats"],
        "replicas": int,
    },
)


class ModelResult(TypedDict):
    """A model's expression and its parameters by ``EFFECT.PARAMETER``."""

    model: str
    parameters: dict[str, ParameterResult]


class StepResult(TypedDict):
    """One effect that was found, and the errors once it is in the model."""

    effect: str
    parameters: dict[str, ParameterResult]
    evidence: dict[str, object]
    after: PairOfErrors
    indistinguishable_from: list[str]


class CandidateResult(TypedDict):
    """One effect that was tried."""

    effect: str
    score: float
    rejected_because: str


class LogResult(TypedDict, total=False):
    """One log and its errors; without file and hash where it was in memory."""

    file: str
    sha256: str
    role: Literal["train", "holdout"]
    before: ErrorResult
    after: ErrorResult
    floor: ErrorResult
    initial: dict[str, float]
    own_start: dict[str, object] | None


class ResidualResult(TypedDict):
    """What is left."""

    white: bool
    depends_on: list[str]
    empirical: dict[str, object] | None
    tests: dict[str, object]


class NoiseResult(TypedDict):
    """Noise of sensor and torque; ``sensor_by_log`` is there where the sensor's differs between logs, and
    ``sensor_of_angle`` where speeds are taken from an angle that is noisy.
    """

    sensor_rms: ParameterResult
    sensor_by_log: NotRequired[dict[str, float]]
    sensor_of_angle: NotRequired[bool]
    torque_rms_pct: ParameterResult
    torque_time_s: ParameterResult


class NextExperiment(TypedDict, total=False):
    """What would tell more."""

    why: str
    experiment: str


class DiagnosisResult(TypedDict, total=False):
    """The whole. Keys beside those of the schema's first version are kept as they are written."""

    schema: str
    fiohost_version: str
    seconds: float
    output_unit: str
    searched_as: dict[str, object]
    declared: ModelResult
    verdict: Literal["no_missing_effect", "explained", "unexplained"]
    explained_to: Literal["sensor", "noise", "repeatability", "tolerance"] | None
    explained_pct: float | None
    left_pct: float | None
    tolerance_pct: float
    noise: NoiseResult | None
    run_to_run: dict[str, dict[str, object]]
    settings: dict[str, object]
    clock: str
    before: PairOfErrors
    steps: list[StepResult]
    after: PairOfErrors
    final: ModelResult
    floor: FloorResult
    logs: list[LogResult]
    candidates: list[CandidateResult]
    residual: ResidualResult
    curves: list[dict[str, object]]
    unnamed: dict[str, object] | None
    extrapolates: list[dict[str, object]]
    own_start: dict[str, object] | None
    holdout_not_followed: list[dict[str, object]]
    next_experiment: NextExperiment | None
    detection_limits: list[dict[str, object]]
    separation: dict[str, object] | None
    constants: dict[str, object]

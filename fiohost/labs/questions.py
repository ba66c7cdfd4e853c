"""What the two texts ask in each experiment, in words of our own, with the section where it is asked.

``answers`` are beginnings of a lab's own answers, which its page puts beside the question. A question without them is
the student's: the page leaves room for it.
"""

from __future__ import annotations

from dataclasses import dataclass

from fiohost.labs.result import Answer, LabResult


@dataclass(frozen=True)
class Asked:
    """One question of a text."""

    where: str
    text: str
    answers: tuple[str, ...] = ()


def _step(section: str, number: int, text: str, *more: str) -> Asked:
    return Asked(f"section {section}, step {number}", text, (f"Step {number}.", *more))


_OPEN_STEP = (
    _step("D-4-1", 1, "What speed does the model settle to for +1, +3 and -2 V, and is it that of the formula?"),
    _step("D-4-1", 2, "Beginning with none, how does more viscous friction change the speed response?"),
    _step("D-4-1", 3, "How much viscous friction halves the speed that the motor would have without any?"),
    _step("D-4-1", 4, "What does a load torque that suddenly comes do to the speed?"),
    _step("D-4-1", 5, "Can the inertia be read off the speed response? And the friction? Does it agree?"),
    _step("D-4-1", 6, "Which other constants can be had from the response in time, and which cannot?"),
    _step("D-4-1", 7, "The same voltages on the bench: how far is it from the model?"),
    _step("D-4-1", 8, "From transient and steady state: which model describes the bench best?"),
)
_SINE = (
    _step("D-4-2", 9, "Gain and phase at 0.5 to 10 rad/s with 2 V: what do they do as the frequency rises?"),
    _step("D-4-2", 10, "And with 10 V, where the amplifier gives 4.5 V only: what is a gain then worth?"),
)
_SPEED = (
    _step("D-4-3", 11, "Steps of 12, -10 and 15 rad/s under proportional gains of 0.1, 0.5 and 1: what comes of them?"),
    _step("D-4-3", 12, "A gear head of 1:24 is added: which inertia counts, and what changes?"),
    _step("D-4-3", 13, "Without the gear again: by how much does the gain change the final speed?"),
    _step("D-4-3", 14, "Inertia and friction once more, this time from the closed loop: do they agree?"),
    _step("D-4-3", 15, "The same steps on the bench: how different are they?"),
)
_POSITION = (
    _step("D-4-4", 16, "A step of 160 degrees at gains of 1.5, 2 and 5: which error is left in the end?"),
    _step("D-4-4", 17, "The same with a load torque: which error now, and why?"),
    _step("D-4-4", 18, "What does an integral do about it, small or large?"),
    _step("D-4-4", 19, "What does more inertia do to the loop with the integral, on the way and in the end?"),
    _step("D-4-4", 20, "What do the limits of voltage and current do?"),
    _step("D-4-4", 21, "Which PI overshoots by 30 % and rises in 0.1 s, and how large may its step be before something "
          "saturates?"),
    _step("D-4-4", 22, "In all of this: where does the second-order formula hold, and where not?"),
    _step("D-4-4", 23, "The gains of step 16 on the bench: what is different?"),
    _step("D-4-4", 24, "Where does the bench saturate?"),
    _step("D-4-4", 25, "Does the PI of step 21 do on the bench what it was designed for?"),
)  # fmt: skip

QUESTIONS: dict[str, tuple[Asked, ...]] = {
    "manual": (
        Asked(
            "INC451, section 2.4.1.2, table 2.3",
            "Which direction bits turn the motor forward and back, brake it and "
            "let it run out, and what parts the last two?",
            ("How do duty and the two bits",),
        ),
        Asked(
            "INC451, section 2.4.1.2",
            "How do the edges of both encoder channels become an angle of 0 to 360 degrees?",
            ("How do encoder counts",),
        ),
        Asked(
            "INC451, section 2.4.1.4",
            "From which duty does the motor start, forward and in reverse?",
            ("From which duty",),
        ),
        Asked(
            "INC451, section 2.4.1",
            "What do Coulomb and viscous friction do to a motor that is driven slowly?",
            ("What do dry and viscous",),
        ),
    ),
    "precompensation": (
        Asked(
            "INC451, section 2.4.2.2, step 2",
            "With the measured deadband put into the compensation: does the loop jitter?",
            ("Does the loop jitter",),
        ),
        Asked(
            "INC451, section 2.4.2.2, step 2",
            "How far must the compensation be reduced until it does not?",
            ("How far has it",),
        ),
        Asked(
            "INC451, section 2.4.2.1",
            "Why is less compensated than the whole deadband, and what is gained by it?",
            ("What does the compensation",),
        ),
        Asked("INC451, section 2.4.2.1", "Is there a limit cycle when too much is compensated?", ("Is there a limit",)),
    ),
    "identification": (
        Asked(
            "INC451, section 2.4.2.2, step 2",
            "Overshoot, rise and settling time of the step, and the natural frequency and damping that they say?",
            ("What do the figures of the step",),
        ),
        Asked(
            "INC451, section 2.4.2.2, steps 2 and 3",
            "Gain and time constant of the motor, from the figures of the step "
            "and from a fit of the whole response: how far are they apart, and why?",
            ("How do the two methods", "Why: friction", "Why: the time"),
        ),
        Asked("INC451, section 2.4.2.2, step 3", "Which of the two would you design with?", ("Which model",)),
    ),
    "design": (
        Asked(
            "INC451, section 2.4.3",
            "Does the discrete PD keep overshoot, settling time and error within their bounds "
            "in simulation, with limit and deadband in it?",
            ("Does the design meet",),
        ),
        Asked("INC451, section 2.4.3", "Does it on the bench, for all three square waves?", ("Does it on the target",)),
        Asked(
            "INC451, section 2.4.3",
            "How close do simulation and bench come, and where does the duty reach its limit?",
            ("How close", "Where does the duty"),
        ),
    ),
    "characterise": (
        Asked(
            "section D-1-3",
            "Armature resistance from the stalled motor, and the inductance of its winding?",
            ("What are resistance", "How was each constant"),
        ),
        Asked(
            "section D-1-4",
            "Are the torque constant and the back-emf constant the same number?",
            ("Are torque and back-emf",),
        ),
        Asked(
            "section D-1-4, Figs. D-21 and D-22",
            "How does the speed fall with the load, and what does the friction do as the power rises?",
            ("How does the speed fall", "What does the friction do"),
        ),
        Asked("section D-1-4, Fig. D-23", "Does the motor run down, input off, as the constants say?", ("Run-down",)),
    ),
    "fine-tuning": (
        Asked(
            "section D-1-6",
            "Which constant, changed by how much, makes the model follow the measured response?",
            ("Which ",),
        ),
        Asked(
            "section D-1-6, Eqs. D-16 to D-25",
            "Where do the poles go, and what should that do to the response?",
            ("Where do the poles",),
        ),
        Asked(
            "section D-1-6, Eqs. D-26 to D-29",
            "Do the formulas agree with what is seen?",
            ("How far can the formulas",),
        ),
        Asked("section D-1-6", "Is the model good enough now, or would you go on with the friction?"),
    ),
    "open-loop-step": _OPEN_STEP,
    "open-loop-sine": _SINE,
    "speed-control": _SPEED,
    "position-control": _POSITION,
    "steps": (*_OPEN_STEP, *_SINE, *_SPEED, *_POSITION),
    "design-project": (
        Asked(
            "section D-5",
            "How fast can the payload be in the cup, with 5 degrees of overshoot at most and settled within 3 %?",
            ("How fast and how well",),
        ),
        Asked(
            "section D-5",
            "What does a proportional gain of 3 do, and when should the gripper open?",
            ("What does the text's",),
        ),
        Asked("section D-5", "How must the controller change when the cup stands elsewhere, or the arm is longer?"),
    ),
    "elevator": (
        Asked(
            "section D-2, design criteria",
            "Which controllers keep overshoot, error and settling time within their bounds?",
            ("Which P gains", "Which design meets"),
        ),
        Asked(
            "section D-2-3",
            "How close does the simulation come to the elevator, and would more friction in it help?",
            ("Does the text's block", "Is the model good"),
        ),
        Asked(
            "section D-2-4",
            "What leaves the error of the P controller, and which integral takes it away, both ways?",
            ("What leaves", "Which integral"),
        ),
        Asked(
            "section D-2-5",
            "Two ways to less overshoot: a derivative, and less power. What does each cost?",
            ("What does a derivative", "What does limiting"),
        ),
        Asked(
            "section D-2-6",
            "By the buttons: does the car reach the floors asked for, within the criteria?",
            ("Does the car reach",),
        ),
    ),
}


@dataclass(frozen=True)
class Paired:
    """The text's questions, each with the answers of a run, and the answers that belong to none of them."""

    asked: tuple[tuple[Asked, tuple[Answer, ...]], ...]
    others: tuple[Answer, ...]


def paired(result: LabResult) -> Paired:
    """A lab's questions and its answers side by side; a problem has its questions in its own answers."""
    asked = tuple(
        (item, tuple(a for a in result.answers if item.answers and a.question.startswith(item.answers)))
        for item in QUESTIONS.get(result.name, ())
    )
    used = {answer.question for _, found in asked for answer in found}
    return Paired(asked, tuple(a for a in result.answers if a.question not in used))

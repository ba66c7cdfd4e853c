"""A controller as C for firmware: one header without a library, statement for statement the law that a run uses.

With ``FIOHOST_REAL`` double (the default) and no fused multiply-add (``-ffp-contract=off``) its duties are those of
:class:`fiohost.control.law.ControlLaw`, bit for bit; with float they agree to single precision.
"""

from __future__ import annotations

from fiohost import __version__
from fiohost.control.law import ControlLaw
from fiohost.control.settings import ControlSettings

TEMPLATE = """\
/* {kind} controller of a DC motor's angle, written by fiohost {version}{comment}.
 *
 * Call {name}_step once in every tick of {tick_ms} ms, with reference and angle in degrees; the angle must not jump at
 * 0 and 360. It gives the signed duty in percent of full scale, -{limit} to {limit}. C99, no library; define
 * FIOHOST_REAL as float before including this where the processor has no double.
 *
 *     {name}_t controller;
 *     {name}_reset(&controller);
 *     for (;;) {{ wait_for_tick(); set_duty({name}_step(&controller, reference_deg, angle_deg)); }}
 */
#ifndef {guard}
#define {guard}

#ifndef FIOHOST_REAL
#define FIOHOST_REAL double
#endif

typedef struct {{
    FIOHOST_REAL before;   /* what is differentiated, at the last tick */
    FIOHOST_REAL slope;    /* of it, filtered */
    FIOHOST_REAL integral; /* percent */
    int has_before;
}} {name}_t;

{constants}

static inline void {name}_reset({name}_t *c)
{{
    c->before = c->slope = c->integral = 0;
    c->has_before = 0;
}}

static inline FIOHOST_REAL {name}_step({name}_t *c, FIOHOST_REAL reference_deg, FIOHOST_REAL angle_deg)
{{
    const FIOHOST_REAL error = reference_deg - angle_deg;
{unused}{integrate}    FIOHOST_REAL wanted = {guard}_KP * error;
{differentiate}{add_integral}
    /* deadband compensation and limit */
    FIOHOST_REAL compensated = 0;
    if (wanted > {guard}_THRESHOLD)
        compensated = wanted + {guard}_U_PLUS;
    else if (wanted < -{guard}_THRESHOLD)
        compensated = wanted + {guard}_U_MINUS;
    FIOHOST_REAL duty = compensated;
    if (duty > {guard}_LIMIT)
        duty = {guard}_LIMIT;
    else if (duty < -{guard}_LIMIT)
        duty = -{guard}_LIMIT;
{unwind}    return duty;
}}

#endif
"""

INTEGRATE = "    c->integral += {guard}_KI_TICK * error;\n"
DIFFERENTIATE = """\
    const FIOHOST_REAL signal = {signal};
    const FIOHOST_REAL change = c->has_before ? signal - c->before : 0; /* no kick from the first reading */
    c->before = signal;
    c->has_before = 1;
    c->slope = {guard}_KEEP * c->slope + {guard}_NEW * change;
    wanted = wanted + {guard}_KD * c->slope;
"""
ADD_INTEGRAL = "    wanted = wanted + c->integral;\n"
UNWIND = """\
    /* the integral gives back what the limit cut off, and no more than it holds */
    const FIOHOST_REAL back = {guard}_RETURNED * ((wanted + (duty - compensated)) - wanted);
    FIOHOST_REAL next = c->integral + back;
    if (back < 0) {{
        const FIOHOST_REAL least = c->integral < 0 ? c->integral : 0;
        c->integral = next > least ? next : least;
    }} else {{
        const FIOHOST_REAL most = c->integral > 0 ? c->integral : 0;
        c->integral = next < most ? next : most;
    }}
"""


def controller_c(
    settings: ControlSettings, sample_time_s: float, name: str = "fiohost_controller", comment: str = ""
) -> str:
    """The header's text. Raises ConfigError for settings that make no controller."""
    law: ControlLaw = settings.law(sample_time_s)  # refuses what is none
    controller = law.controller
    guard = name.upper()
    numbers = {"KP": settings.kp_pct_per_deg}
    integrates = settings.kind in ("pi", "pid") and settings.ki_pct_per_deg_s != 0.0
    differentiates = settings.kind in ("pd", "pid")
    if integrates:
        numbers["KI_TICK"] = settings.ki_pct_per_deg_s * sample_time_s
        numbers["RETURNED"] = sample_time_s / max(settings.tracking_s, sample_time_s)
    if differentiates:
        numbers["KD"] = settings.kd_pct_s_per_deg
        numbers["KEEP"] = settings.filter_s / (settings.filter_s + sample_time_s)
        numbers["NEW"] = 1.0 / (settings.filter_s + sample_time_s)
    numbers |= {
        "U_PLUS": settings.u_plus_pct,
        "U_MINUS": settings.u_minus_pct,
        "THRESHOLD": settings.threshold_pct,
        "LIMIT": settings.limit_pct,
    }
    assert controller.gains
    words = " ".join(comment.replace("*/", "").split())
    return TEMPLATE.format(
        kind=settings.kind.upper(),
        version=__version__,
        comment=f" for {words}" if words else "",
        name=name,
        guard=guard,
        tick_ms=f"{1e3 * sample_time_s:g}",
        limit=f"{settings.limit_pct:g}",
        constants="\n".join(f"#define {guard}_{key} ((FIOHOST_REAL){value!r})" for key, value in numbers.items()),
        unused="" if integrates or differentiates else "    (void)c; /* this kind has no memory */\n",
        integrate=INTEGRATE.format(guard=guard) if integrates else "",
        differentiate=DIFFERENTIATE.format(
            guard=guard, signal="-angle_deg" if settings.derivative_on == "angle" else "error"
        )
        if differentiates
        else "",
        add_integral=ADD_INTEGRAL if integrates else "",
        unwind=UNWIND.format(guard=guard) if integrates else "",
    )

"""Edges that the counter does not see: each one adds its share to the loss, and a whole one is not counted."""

from firmware_model.effect import Effect, Parameter

EFFECT = Effect(
    name="missed_counts",
    summary="a share of the counts is lost",
    equation="counts = (1 - ratio) edges",
    parameters=(Parameter("ratio", lower=0.0, upper=0.95),),
    source="Input filter of an encoder timer near its limit",
    reduced=lambda plant, q: {"ratio": q["ratio"]},
    structure=lambda plant, q: {"SHARE_LOST": q["ratio"]},
)

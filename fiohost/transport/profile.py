"""A target profile: what the host must know about a board, as data from ``configs/targets/NAME.toml``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from fiohost.settings import find_config, read_toml
from fiohost.wire.layout import Layout
from fiohost.wire.messages import COMMAND_FIELDS, TELEMETRY_FIELDS, Codec

SCHEMA = "fiohost.target/1"
DEFAULT_PROFILE = "hid-assumed"
MEDIA = ("hid", "serial", "sim")
STATUSES = ("assumed", "documented", "measured")


@dataclass(frozen=True)
class TargetProfile:
    """One board: medium, layouts, identity and limits."""

    name: str
    title: str
    transport: str
    status: str  # how well the layout is known
    sample_time_s: float
    counts_per_rev: int
    duty_steps: int  # timer counts of a PWM period, to which the target truncates the duty; 0 unknown
    vendor_id: int | None
    product_id: int | None
    limit_duty_pct: float
    codec: Codec

    @classmethod
    def load(cls, name_or_path: str | Path = DEFAULT_PROFILE) -> TargetProfile:
        """Read a profile by name or path. Raises ConfigError for unknown keys and layouts that do not fit."""
        path = find_config("targets", name_or_path)
        top = read_toml(path)
        top.schema(SCHEMA)
        title = top.text("title", path.stem)
        transport = top.text("transport", choices=MEDIA)
        status = top.text("status", "assumed", choices=STATUSES)
        sample_time_s = top.number("sample_time_s", 0.005, low=1e-4, high=1.0)
        counts_per_rev = top.integer("counts_per_rev", 720, low=4, high=1 << 24)
        duty_steps = top.integer("duty_steps", 0, low=0, high=1 << 32)
        identity, limits = top.table("identity"), top.table("limits")
        command = Layout.from_table(top.table("command", required=True), COMMAND_FIELDS, COMMAND_FIELDS)
        telemetry = Layout.from_table(top.table("telemetry", required=True), TELEMETRY_FIELDS, TELEMETRY_FIELDS)
        top.finish()
        vendor_id = None if identity.raw("vendor_id") is None else identity.integer("vendor_id", low=0, high=0xFFFF)
        product_id = None if identity.raw("product_id") is None else identity.integer("product_id", low=0, high=0xFFFF)
        identity.finish()
        limit_duty_pct = limits.number("duty_pct", 100.0, low=0.0, high=100.0)
        limits.finish()
        codec = Codec(command, telemetry, counts_per_rev)
        return cls(
            path.stem, title, transport, status, sample_time_s, counts_per_rev, duty_steps, vendor_id, product_id,
            limit_duty_pct, codec,
        )  # fmt: skip

    def with_counts(self, counts_per_rev: int | None) -> TargetProfile:
        """The same board with another encoder setting; None changes nothing."""
        if counts_per_rev is None or counts_per_rev == self.counts_per_rev:
            return self
        codec = Codec(self.codec.command_layout, self.codec.telemetry_layout, counts_per_rev)
        return replace(self, counts_per_rev=counts_per_rev, codec=codec)

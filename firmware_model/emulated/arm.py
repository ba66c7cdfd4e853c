"""The STM32F103 of a Blue Pill: unicorn executes the program, :mod:`.stm32f103` is the rest of the chip.

Instructions take no time: between two sleeps of the core the clock stands. unicorn is no dependency of this package:
where it is not installed there is no emulated Blue Pill, and the error says what to install.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from firmware_model.emulated.chip import Level
from firmware_model.emulated.hexfile import read_hex
from firmware_model.emulated.stm32f103 import ChipError, Stm32f103
from firmware_model.errors import FirmwareModelError
from firmware_model.quadrature import Edge

FLASH, FLASH_BYTES = 0x08000000, 64 << 10
MEMORY, MEMORY_BYTES = 0x20000000, 20 << 10
PERIPHERALS = ((0x40000000, 0x24000), (0xE000E000, 0x1000), (0xE0042000, 0x1000))
WFI = bytes.fromhex("30bf")
MOST_INSTRUCTIONS = 3_000_000  # without a sleep: 40 ms of a core at 72 MHz
BAUD = 500_000
INSTALL = "pip install unicorn"
WATCHED = ("PA2", "PA3", "PB12", "PB13", "PB14")


class Stm32:
    """One chip with the program of a .hex file. Its serial line runs at *baud* on the host's side."""

    hertz = 72e6

    def __init__(self, image: Path, baud: int = BAUD) -> None:
        try:
            import unicorn
        except ImportError as exc:
            raise FirmwareModelError(f"the emulated Blue Pill needs the package unicorn: {INSTALL}") from exc
        self._unicorn: Any = unicorn
        self._code, self._baud = read_hex(image), baud
        self._off_s = 0.0  # time before the last reset
        self._edges: list[Edge] = []
        self._levels = 0
        self.resets = 0
        self.instructions = 0  # of the longest run between two sleeps, where counted
        self._counts = False
        self._power_on()

    def _power_on(self) -> None:
        unicorn, arm = self._unicorn, self._unicorn.arm_const
        core = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        core.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M3)
        core.mem_map(FLASH, FLASH_BYTES)
        core.mem_write(FLASH, self._code)
        core.mem_map(MEMORY, MEMORY_BYTES)
        self._failed: Exception | None = None
        self.around = Stm32f103(
            lambda at, size: bytes(core.mem_read(at, size)), lambda at, data: core.mem_write(at, data), self._baud
        )
        self.around.put_levels(self._levels)
        for base, size in PERIPHERALS:
            core.mmio_map(base, size, self._read, base, self._write, base)
        core.reg_write(arm.UC_ARM_REG_SP, int.from_bytes(self._code[:4], "little"))
        core.reg_write(arm.UC_ARM_REG_PC, int.from_bytes(self._code[4:8], "little") | 1)
        self._core, self._pc = core, arm.UC_ARM_REG_PC
        self._entry: int | None = int.from_bytes(self._code[4:8], "little") & ~1
        self._awake = True
        if self._counts:
            self.count_instructions()

    def _read(self, core: Any, offset: int, size: int, base: int) -> int:
        try:
            return self.around.read(base + offset)
        except FirmwareModelError as exc:
            self._fail(exc)
            return 0

    def _write(self, core: Any, offset: int, size: int, value: int, base: int) -> None:
        try:
            self.around.write(base + offset, value)
        except FirmwareModelError as exc:
            self._fail(exc)

    def _fail(self, exc: Exception) -> None:
        self._failed = self._failed or exc
        self._core.emu_stop()

    @property
    def time_s(self) -> float:
        return self._off_s + self.around.time_s

    def run_to(self, time_s: float) -> None:
        before = self._outputs()
        while self.time_s < time_s:
            if self._awake:
                self._execute()
                if self._outputs() != before:
                    return
                continue
            edge_s = self._edges[0].time_s if self._edges else time_s
            self.around.pass_time(min(time_s, max(edge_s, self.time_s)) - self._off_s)
            while self._edges and self._edges[0].time_s <= self.time_s:
                self._levels = self._edges.pop(0).levels
                self.around.put_levels(self._levels)
            self._awake = self.around.pending
            if self.around.starved:
                self._reset()
                return

    def _reset(self) -> None:
        """What the independent watchdog does."""
        self._off_s = self.time_s
        self.resets += 1
        self._power_on()

    def _execute(self) -> None:
        """Run until the core sleeps."""
        core = self._core
        at = core.reg_read(self._pc) if self._entry is None else self._entry
        self._entry = None
        self._run = 0
        try:
            core.emu_start(at | 1, 0xFFFFFFFF, count=MOST_INSTRUCTIONS)
        except self._unicorn.UcError as exc:
            at = core.reg_read(self._pc)
            raise ChipError(f"the program on the emulated Blue Pill crashed at {at:08x}: {exc}") from exc
        if self._failed is not None:
            raise self._failed
        at = core.reg_read(self._pc)
        if bytes(core.mem_read(at - 2, 2)) != WFI:
            raise ChipError(f"the program on the emulated Blue Pill does not come to rest: it is at {at:08x}")
        self.instructions = max(self.instructions, self._run)
        self._awake = self.around.pending

    def count_instructions(self) -> None:
        """Count instructions from now on: :attr:`instructions`. This takes time."""

        def count(core: Any, address: int, size: int, _: Any) -> None:
            self._run += 1

        self._counts, self.instructions, self._run = True, 0, 0
        self._core.hook_add(self._unicorn.UC_HOOK_CODE, count)

    def _outputs(self) -> tuple[Level | None, ...]:
        return tuple(self.around.output(pin) for pin in WATCHED)

    def output(self, pin: str) -> Level | None:
        return self.around.output(pin)

    def put_edges(self, edges: Sequence[Edge]) -> None:
        self._edges = list(edges)

    def receive(self, data: bytes) -> None:
        self.around.receive(data)

    def sent(self) -> bytes:
        return self.around.sent()

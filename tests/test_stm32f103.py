"""The model of the STM32F103 alone: which register write does what, by the reference manual RM0008.

No line of the firmware is in this: addresses and bits are those of the manual.
"""

from __future__ import annotations

import pytest

from firmware_model.emulated.chip import HIGH, LOW, Level
from firmware_model.emulated.stm32f103 import ChipError, Stm32f103
from firmware_model.encoder import levels_of

RCC, FLASH = 0x40021000, 0x40022000
PORT_A, PORT_B = 0x40010800, 0x40010C00
TIM2, TIM3 = 0x40000000, 0x40000400
USART, DMA = 0x40013800, 0x40020000
SYSTICK, ICSR, IWDG = 0xE000E010, 0xE000ED04, 0x40003000
BAUD = 500_000


class Bench:
    """A chip with a piece of memory."""

    def __init__(self) -> None:
        self.memory = bytearray(4096)
        self.chip = Stm32f103(self._get, self._put, BAUD)
        self.read, self.write = self.chip.read, self.chip.write

    def _get(self, at: int, size: int) -> bytes:
        return bytes(self.memory[at : at + size])

    def _put(self, at: int, data: bytes) -> None:
        self.memory[at : at + len(data)] = data


@pytest.fixture
def cold() -> Bench:
    """As after a reset."""
    return Bench()


@pytest.fixture
def bench() -> Bench:
    """At 72 MHz, every block with its clock."""
    one = Bench()
    one.write(FLASH, 0x2)
    one.write(RCC, 1 << 16)
    one.write(RCC + 4, 7 << 18 | 1 << 16 | 4 << 8)
    one.write(RCC, 1 << 24 | 1 << 16)
    one.write(RCC + 4, 7 << 18 | 1 << 16 | 4 << 8 | 2)
    one.write(RCC + 0x14, 1)
    one.write(RCC + 0x18, 1 << 14 | 0b11100)
    one.write(RCC + 0x1C, 3)
    return one


# ---- clocks ---------------------------------------------------------------------------------------------------------


def test_after_a_reset_the_core_runs_at_8_mhz_from_its_own_oscillator(cold: Bench) -> None:
    assert cold.chip.core_hz == 8e6
    assert cold.read(RCC) & 3 == 3  # HSION, HSIRDY


def test_the_pll_multiplies_the_crystal_and_ready_bits_follow(bench: Bench) -> None:
    assert bench.chip.core_hz == 72e6
    assert bench.chip.timer_hz == 72e6  # APB1 is divided by 2, its timers are doubled
    assert bench.read(RCC) >> 17 & 1  # HSERDY
    assert bench.read(RCC) >> 25 & 1  # PLLRDY
    assert bench.read(RCC + 4) >> 2 & 3 == 2  # SWS: the PLL


@pytest.mark.parametrize(
    ("waits", "setting", "reason"),
    [
        (0, 7 << 18 | 1 << 16 | 4 << 8 | 2, "wait states"),
        (2, 8 << 18 | 1 << 16 | 4 << 8 | 2, "wait states"),  # 80 MHz
        (2, 7 << 18 | 1 << 16 | 2, "APB1"),
        (2, 7 << 18 | 1 << 16 | 4 << 8 | 8 << 4 | 2, "divided core clock"),
    ],
)
def test_clocks_that_cannot_be_are_refused(cold: Bench, waits: int, setting: int, reason: str) -> None:
    cold.write(FLASH, waits)
    cold.write(RCC, 1 << 24 | 1 << 16)
    with pytest.raises(ChipError, match=reason):
        cold.write(RCC + 4, setting)


def test_a_block_without_its_clock_takes_nothing_and_reads_zero(cold: Bench) -> None:
    cold.write(PORT_B + 4, 0x33333333)
    assert cold.read(PORT_B + 4) == 0
    assert cold.chip.output("PB12") is None
    cold.write(RCC + 0x18, 1 << 3)
    assert cold.read(PORT_B + 4) == 0x44444444  # floating inputs, as after a reset


@pytest.mark.parametrize("address", [0x40014000, 0x40021040, 0xE000E100, 0x40000444])
def test_what_the_model_does_not_have_is_refused_by_address(bench: Bench, address: int) -> None:
    with pytest.raises(ChipError, match=f"{address:08x}"):
        bench.read(address)
    with pytest.raises(ChipError, match=f"{address:08x}"):
        bench.write(address, 1)


# ---- ports ----------------------------------------------------------------------------------------------------------


def test_a_pin_puts_out_what_its_port_says_once_it_is_an_output(bench: Bench) -> None:
    bench.write(PORT_B + 0x10, 1 << 12)  # BSRR: set
    assert bench.chip.output("PB12") is None
    bench.write(PORT_B + 4, 0x44434444)
    assert bench.chip.output("PB12") == HIGH
    assert bench.chip.output("PB13") is None
    bench.write(PORT_B + 0x10, 1 << 28)  # BSRR: reset
    assert bench.chip.output("PB12") == LOW
    bench.write(PORT_B + 0x10, 1 << 28 | 1 << 12)  # both: set wins
    assert bench.chip.output("PB12") == HIGH
    bench.write(PORT_B + 0x14, 1 << 12)  # BRR
    assert bench.chip.output("PB12") == LOW
    assert bench.read(PORT_B + 0x0C) == 0


def test_an_open_drain_pulls_down_only(bench: Bench) -> None:
    bench.write(PORT_B + 4, 0x44474444)
    assert bench.chip.output("PB12") == LOW
    bench.write(PORT_B + 0x10, 1 << 12)
    assert bench.chip.output("PB12") is None


# ---- timer 2: PWM ---------------------------------------------------------------------------------------------------


def pwm(bench: Bench, compare: int, channel: int = 4) -> Level | None:
    bench.write(PORT_A, 0x4444BB44)  # PA2, PA3: alternate function, push-pull
    bench.write(TIM2 + 0x2C, 3599)
    bench.write(TIM2 + 0x1C, 0x6868)  # both channels of CCMR2: PWM mode 1, preloaded
    bench.write(TIM2 + 0x20, 1 << 4 * (channel - 1))
    bench.write(TIM2 + 0x34 + 4 * (channel - 1), compare)
    bench.write(TIM2, 0x81)
    return bench.chip.output({3: "PA2", 4: "PA3"}[channel])


def test_a_channel_is_high_for_its_compare_value_of_a_period(bench: Bench) -> None:
    assert pwm(bench, 1440) == Level(1440, 3600)
    assert pwm(bench, 0) == Level(0, 3600)
    assert pwm(bench, 3600) == pwm(bench, 9000) == Level(3600, 3600)
    assert pwm(bench, 7, channel=3) == Level(7, 3600)
    assert bench.chip.output("PA3") == LOW  # its channel is off
    assert bench.chip.pwm_hz == pytest.approx(20e3)
    bench.write(TIM2 + 0x28, 1)
    assert bench.chip.pwm_hz == pytest.approx(10e3)


def test_modes_that_are_not_modelled_are_refused(bench: Bench) -> None:
    pwm(bench, 100)
    bench.write(TIM2 + 0x1C, 0x7868)  # PWM mode 2
    with pytest.raises(ChipError, match="not modelled"):
        bench.chip.output("PA3")
    bench.write(TIM2 + 0x1C, 0x6868)
    bench.write(TIM2 + 0x20, 0x3000)  # inverted
    with pytest.raises(ChipError, match="not modelled"):
        bench.chip.output("PA3")


# ---- timer 3: encoder -----------------------------------------------------------------------------------------------


def encoder(bench: Bench, mode: int = 3, top: int = 719, polarity: int = 0) -> None:
    bench.write(PORT_A, 0x88444444)
    bench.write(TIM3 + 0x18, 0x0101)
    bench.write(TIM3 + 0x08, mode)
    bench.write(TIM3 + 0x20, polarity)
    bench.write(TIM3 + 0x2C, top)
    bench.write(TIM3, 1)


def turn(bench: Bench, start: int, edges: int) -> int:
    """Turn the disc from a state by so many edges; the state it ends in."""
    step = 1 if edges > 0 else -1
    for k in range(1, abs(edges) + 1):
        bench.chip.put_levels(int(levels_of(start + step * k)))
    return start + edges


def test_every_edge_of_both_inputs_counts_up_where_input_1_leads(bench: Bench) -> None:
    encoder(bench)
    turn(bench, 0, 10)
    assert bench.read(TIM3 + 0x24) == 10
    assert bench.read(TIM3) >> 4 & 1 == 0
    turn(bench, 10, -3)
    assert bench.read(TIM3 + 0x24) == 7
    assert bench.read(TIM3) >> 4 & 1 == 1  # DIR: counting down


def test_the_counter_wraps_at_its_reload_value_both_ways(bench: Bench) -> None:
    encoder(bench)
    turn(bench, 0, -1)
    assert bench.read(TIM3 + 0x24) == 719
    turn(bench, -1, 1)
    assert bench.read(TIM3 + 0x24) == 0
    turn(bench, 0, 1450)
    assert bench.read(TIM3 + 0x24) == 10


@pytest.mark.parametrize(("mode", "counts"), [(1, 4), (2, 4), (3, 8), (0, 0)])
def test_each_encoder_mode_counts_its_own_edges(bench: Bench, mode: int, counts: int) -> None:
    encoder(bench, mode)
    turn(bench, 0, 8)
    assert bench.read(TIM3 + 0x24) == counts


def test_an_inverted_input_turns_the_direction_round(bench: Bench) -> None:
    encoder(bench, polarity=1 << 1)
    turn(bench, 0, 5)
    assert bench.read(TIM3 + 0x24) == 715


def test_a_timer_that_is_off_or_not_mapped_does_not_count(bench: Bench) -> None:
    encoder(bench)
    bench.write(TIM3, 0)
    turn(bench, 0, 4)
    assert bench.read(TIM3 + 0x24) == 0
    bench.write(TIM3, 1)
    bench.write(TIM3 + 0x18, 0)
    with pytest.raises(ChipError, match="not mapped"):
        turn(bench, 4, 1)


# ---- serial line and DMA --------------------------------------------------------------------------------------------


def line(bench: Bench, baud_register: int = 144) -> None:
    bench.write(USART + 0x08, baud_register)
    bench.write(USART + 0x14, 0xC0)
    bench.write(USART + 0x0C, 0x200C)


def channel(bench: Bench, number: int, at: int, count: int, control: int) -> None:
    base = DMA + 0x08 + 20 * (number - 1)
    bench.write(base, 0)
    bench.write(base + 4, count)
    bench.write(base + 8, USART + 4)
    bench.write(base + 12, at)
    bench.write(base, control)


def test_bytes_that_arrive_go_round_in_memory(bench: Bench) -> None:
    line(bench)
    channel(bench, 5, 100, 4, 0xA1)
    bench.chip.receive(b"abcdef")
    bench.chip.pass_time(3.5 * 20e-6)
    assert bench.memory[100:104] == b"abc\0"
    assert bench.read(DMA + 0x5C) == 1  # CNDTR5: places left
    bench.chip.pass_time(1.0)
    assert bench.memory[100:104] == b"efcd"
    assert bench.read(DMA + 0x5C) == 2


def test_bytes_leave_memory_one_every_ten_bits(bench: Bench) -> None:
    line(bench)
    bench.memory[200:203] = b"xyz"
    channel(bench, 4, 200, 3, 0x91)
    bench.chip.pass_time(2.5 * 20e-6)
    assert bench.chip.sent() == b"xy"
    bench.chip.pass_time(1.0)
    assert bench.chip.sent() == b"z"
    assert bench.read(DMA + 0x48) == 0


def test_a_channel_that_is_on_is_locked(bench: Bench) -> None:
    line(bench)
    channel(bench, 5, 100, 4, 0xA1)
    bench.write(DMA + 0x5C, 99)
    assert bench.read(DMA + 0x5C) == 4


def test_a_wrong_baud_rate_is_noticed(bench: Bench) -> None:
    line(bench, baud_register=156)
    channel(bench, 5, 100, 4, 0xA1)
    bench.chip.receive(b"a")
    with pytest.raises(ChipError, match="461538 Bd"):
        bench.chip.pass_time(1.0)


def test_a_line_that_is_off_hears_nothing(bench: Bench) -> None:
    bench.chip.receive(b"a")
    bench.chip.pass_time(1.0)
    assert not any(bench.memory)


@pytest.mark.parametrize(("number", "control"), [(4, 0xA1), (5, 0x91), (5, 0x21), (6, 0xA1)])
def test_dma_in_another_mode_is_refused(bench: Bench, number: int, control: int) -> None:
    line(bench)
    with pytest.raises(ChipError, match="not modelled"):
        channel(bench, number, 100, 4, control)


# ---- time -----------------------------------------------------------------------------------------------------------


def test_the_system_timer_makes_its_exception_pending_every_period(bench: Bench) -> None:
    bench.write(SYSTICK + 4, 360_000 - 1)
    bench.write(SYSTICK + 8, 0)
    bench.write(SYSTICK, 7)
    for k in range(1, 4):
        bench.chip.pass_time(1.0)
        assert bench.chip.time_s == pytest.approx(0.005 * k)
        assert bench.read(ICSR) == 1 << 26
        bench.write(ICSR, 1 << 25)
        assert bench.read(ICSR) == 0
    bench.write(SYSTICK, 0)
    bench.chip.pass_time(0.1)
    assert bench.chip.time_s == 0.1


def test_the_system_timer_may_run_at_an_eighth(bench: Bench) -> None:
    bench.write(SYSTICK + 4, 45_000 - 1)
    bench.write(SYSTICK, 3)
    bench.chip.pass_time(1.0)
    assert bench.chip.time_s == pytest.approx(0.005)


def test_the_independent_watchdog_starves_unless_it_is_fed(bench: Bench) -> None:
    bench.write(IWDG + 8, 500)  # locked: nothing happens
    bench.write(IWDG, 0x5555)
    bench.write(IWDG + 4, 1)
    bench.write(IWDG + 8, 499)
    bench.write(IWDG, 0xCCCC)
    for _ in range(5):
        bench.chip.pass_time(bench.chip.time_s + 0.09)
        bench.write(IWDG, 0xAAAA)
    assert not bench.chip.starved
    fed_s = bench.chip.time_s
    bench.chip.pass_time(fed_s + 1.0)
    assert bench.chip.starved
    assert bench.chip.time_s - fed_s == pytest.approx(0.1)  # 8 * 500 / 40 kHz

"""Peripherals of an STM32F103 as far as a motor board needs them: which register write does what.

Written from ST's reference manual RM0008 (and PM0056 for the core's own registers) and independent of the firmware: it
shares no name, no table and no header with it, and has tests of its own. What the manual has and this model has not is
refused, never guessed: an address, a mode or a clock that is unknown here raises ChipError.

Sections of RM0008: clocks 7, ports 9, DMA 13, timers 15, independent watchdog 19, USART 27. Register writes take effect
at once, preloaded ones of the timers too (on the chip: at the end of a PWM period, 50 us).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from firmware_model.emulated.chip import HIGH, LOW, Level
from firmware_model.errors import FirmwareModelError

HSI_HZ, HSE_HZ, LSI_HZ = 8e6, 8e6, 40e3
BITS_OF_A_BYTE = 10
NEVER = float("inf")


class ChipError(FirmwareModelError):
    """The program does what this chip, or this model of it, cannot do."""


@dataclass
class Block:
    """A group of registers as words: what was written is read back, unless the chip says otherwise."""

    base: int
    known: tuple[int, ...]
    clock: tuple[int, int] | None = None  # enable register of the RCC, bit
    words: dict[int, int] = field(default_factory=dict)

    def __getitem__(self, offset: int) -> int:
        return self.words.get(offset, 0)

    def __setitem__(self, offset: int, value: int) -> None:
        self.words[offset] = value & 0xFFFFFFFF


# offsets within the blocks
CR, CFGR, AHBENR, APB2ENR, APB1ENR = 0x00, 0x04, 0x14, 0x18, 0x1C
CRL, CRH, IDR, ODR, BSRR, BRR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14
CR1, SMCR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, CCR1 = 0x00, 0x08, 0x14, 0x18, 0x1C, 0x20, 0x24, 0x28, 0x2C, 0x34
USART_SR, USART_DR, USART_BRR, USART_CR1, USART_CR3 = 0x00, 0x04, 0x08, 0x0C, 0x14
CSR, RVR, CVR, ICSR = 0x10, 0x14, 0x18, 0xD04
KR, PR, RLR = 0x00, 0x04, 0x08
TX_CHANNEL, RX_CHANNEL = 4, 5  # of DMA1, those of USART1
PAGE = 0x400


class Stm32f103:
    """The chip around its core. Time is in seconds since the reset; *read_memory*, *write_memory* serve its DMA."""

    def __init__(
        self,
        read_memory: Callable[[int, int], bytes],
        write_memory: Callable[[int, bytes], None],
        baud: int,
    ) -> None:
        self._read_memory, self._write_memory, self._baud = read_memory, write_memory, baud
        port = (CRL, CRH, IDR, ODR, BSRR, BRR)
        timer = (CR1, SMCR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, *range(CCR1, CCR1 + 16, 4))
        self.rcc = Block(0x40021000, (CR, CFGR, AHBENR, APB2ENR, APB1ENR))
        self.flash = Block(0x40022000, (0x00,))
        self.ports = {
            "A": Block(0x40010800, port, (APB2ENR, 2)),
            "B": Block(0x40010C00, port, (APB2ENR, 3)),
            "C": Block(0x40011000, port, (APB2ENR, 4)),
        }
        self.tim2 = Block(0x40000000, timer, (APB1ENR, 0))
        self.tim3 = Block(0x40000400, timer, (APB1ENR, 1))
        usart = (USART_SR, USART_DR, USART_BRR, USART_CR1, USART_CR3)
        self.usart = Block(0x40013800, usart, (APB2ENR, 14))
        channels = tuple(0x08 + 20 * k + 4 * register for k in range(7) for register in range(4))
        self.dma = Block(0x40020000, (0x00, 0x04, *channels), (AHBENR, 0))
        self.core = Block(0xE000E000, (CSR, RVR, CVR, ICSR))
        self.debug = Block(0xE0042000, (0x04,))
        self.iwdg = Block(0x40003000, (KR, PR, RLR))
        blocks = [self.rcc, self.flash, *self.ports.values(), self.tim2, self.tim3, self.usart, self.dma]
        self._blocks = {block.base: block for block in [*blocks, self.core, self.debug, self.iwdg]}
        self.rcc[CR] = 0x83  # the internal oscillator runs
        self.tim2[ARR] = self.tim3[ARR] = 0xFFFF
        for block in self.ports.values():
            block[CRL] = block[CRH] = 0x44444444  # floating inputs
        self.time_s = 0.0
        self.pending = False  # the system timer's exception
        self.starved = False  # the independent watchdog was not fed
        self._tick_at = self._starve_at = self._out_at = NEVER
        self._unlocked = False
        self._in: deque[tuple[float, int]] = deque()
        self._sent = bytearray()
        self._levels = 0
        self._reload = {TX_CHANNEL: 0, RX_CHANNEL: 0}

    # ---- registers ------------------------------------------------------------------------------------------------

    def _find(self, address: int) -> tuple[Block, int]:
        base = address & ~(PAGE - 1)
        if base & ~0xC00 == self.core.base:
            base = self.core.base
        block = self._blocks.get(base)
        if block is None or (address & ~3) - base not in block.known:
            raise ChipError(f"the program reaches for {address:08x}, which the model does not have")
        return block, (address & ~3) - base

    def _is_clocked(self, block: Block) -> bool:
        return block.clock is None or bool(self.rcc[block.clock[0]] >> block.clock[1] & 1)

    def read(self, address: int) -> int:
        """A register as the program reads it; 0 from a block without its clock."""
        block, offset = self._find(address)
        if not self._is_clocked(block):
            return 0
        if block in self.ports.values() and offset == IDR:
            return self._inputs(block)
        if block is self.rcc and offset == CR:  # oscillators and PLL are ready as soon as they are on
            on = block[CR]
            return on & ~0x02020002 | (on & 0x01010001) << 1
        if block is self.rcc and offset == CFGR:
            return block[CFGR] & ~0xC | (block[CFGR] & 3) << 2
        if block is self.core and offset == ICSR:
            return int(self.pending) << 26
        return block[offset]

    def write(self, address: int, value: int) -> None:
        """A word (or half of one, the other half 0) written by the program; nothing happens without the clock."""
        block, offset = self._find(address)
        if not self._is_clocked(block):
            return
        if block in self.ports.values() and offset in (BSRR, BRR):
            set_, reset = (value & 0xFFFF, value >> 16) if offset == BSRR else (0, value)
            block[ODR] = block[ODR] & ~reset & 0xFFFF | set_
            return
        if block in (self.tim2, self.tim3) and offset == EGR:
            if value & 1:
                block[CNT] = 0
            return
        if block is self.core:
            self._write_core(offset, value)
        elif block is self.iwdg:
            self._write_watchdog(offset, value)
        elif block is self.dma and offset >= 0x08:
            self._write_dma(offset, value)
        elif block is self.usart and offset == USART_DR:
            raise ChipError("the model sends by DMA only, not by writes to the data register")
        else:
            block[offset] = value
            if block is self.rcc or block is self.flash:
                self.core_hz  # noqa: B018 (raises where the clocks cannot be)

    # ---- clocks ---------------------------------------------------------------------------------------------------

    @property
    def core_hz(self) -> float:
        """The core's clock. Raises ChipError for one that is too fast for flash or buses (RM0008 3.3.3, 7.2)."""
        setting, on = self.rcc[CFGR], self.rcc[CR]
        source = setting & 3
        if source == 2 and on >> 24 & 1:
            multiple = min((setting >> 18 & 15) + 2, 16)
            if setting >> 16 & 1:
                base = HSE_HZ / (2 if setting >> 17 & 1 else 1) if on >> 16 & 1 else 0.0
            else:
                base = HSI_HZ / 2
            hertz = base * multiple
        else:
            hertz = HSE_HZ if source == 1 and on >> 16 & 1 else HSI_HZ
        waits = self.flash[0] & 7
        if hertz > 72e6 or hertz > 24e6 * (waits + 1):
            raise ChipError(f"a core of {hertz / 1e6:g} MHz with {waits} wait states of the flash cannot be")
        if setting >> 4 & 8:
            raise ChipError("a divided core clock is not modelled")
        if hertz / self._divider(8) > 36e6:
            raise ChipError("the bus APB1 runs above 36 MHz")
        return hertz

    def _divider(self, shift: int) -> int:
        code = self.rcc[CFGR] >> shift & 7
        return 1 << (code - 3) if code & 4 else 1

    @property
    def timer_hz(self) -> float:
        """Of timers 2 and 3: the bus's clock, doubled where the bus is divided."""
        divider = self._divider(8)
        return self.core_hz / divider * (2 if divider > 1 else 1)

    @property
    def line_baud(self) -> float:
        return self.core_hz / self._divider(11) / max(self.usart[USART_BRR], 1)

    # ---- pins -----------------------------------------------------------------------------------------------------

    def _mode(self, pin: str) -> tuple[Block, int, int, int]:
        """Port, bit, MODE and CNF of a pin such as PA3."""
        block, bit = self.ports[pin[1]], int(pin[2:])
        code = block[CRL if bit < 8 else CRH] >> 4 * (bit % 8) & 15
        return block, bit, code & 3, code >> 2

    def output(self, pin: str) -> Level | None:
        """What a pin puts out; None for an input, and for an open drain that does not pull."""
        block, bit, mode, kind = self._mode(pin)
        if mode == 0:
            return None
        if kind & 2:
            level = self._compare({"PA0": 1, "PA1": 2, "PA2": 3, "PA3": 4}[pin]) if pin in TIM2_PINS else HIGH
        else:
            level = HIGH if block[ODR] >> bit & 1 else LOW
        return None if kind & 1 and level == HIGH else level

    def _compare(self, channel: int) -> Level:
        """A channel of timer 2 on its pin: PWM mode 1, counting up (RM0008 15.3.9)."""
        timer = self.tim2
        enabled = timer[CCER] >> 4 * (channel - 1)
        setting = timer[CCMR1 if channel < 3 else CCMR2] >> 8 * ((channel - 1) % 2)
        if not enabled & 1:
            return LOW
        if setting >> 4 & 7 != 6 or setting & 3 or enabled & 2 or timer[CR1] & 0x70:
            raise ChipError(f"channel {channel} of timer 2 is in a mode that is not modelled")
        if not timer[CR1] & 1:
            return LOW
        period = (timer[ARR] & 0xFFFF) + 1
        return Level(min(timer[CCR1 + 4 * (channel - 1)] & 0xFFFF, period), period)

    @property
    def pwm_hz(self) -> float:
        return self.timer_hz / ((self.tim2[PSC] & 0xFFFF) + 1) / ((self.tim2[ARR] & 0xFFFF) + 1)

    def _inputs(self, block: Block) -> int:
        if block is not self.ports["A"]:
            return 0
        return (self._levels & 3) << 6

    def put_levels(self, levels: int) -> None:
        """The encoder's levels at PA6 (bit 0) and PA7, inputs 1 and 2 of timer 3 (RM0008 15.3.12, table 85)."""
        before, self._levels = self._levels, levels
        timer = self.tim3
        ready = self._is_clocked(timer) and timer[CR1] & 1 and timer[SMCR] & 7 in (1, 2, 3)
        if not ready:
            return
        if self._mode("PA6")[2] or self._mode("PA7")[2]:
            raise ChipError("the encoder's pins are outputs")
        if timer[CCMR1] & 0x303 != 0x101:
            raise ChipError("the encoder's inputs are not mapped to timer 3")
        flipped = (timer[CCER] >> 1 & 1) | (timer[CCER] >> 5 & 1) << 1
        old, new = before ^ flipped, levels ^ flipped
        mode = timer[SMCR] & 7
        first, second = new & 1, new >> 1
        if (old ^ new) & 1 and mode & 2:  # input 1: up where it rises while input 2 is low, or falls while it is high
            self._count(up=first != old >> 1)
        if (old ^ new) & 2 and mode & 1:  # input 2: up where it rises while input 1 is high, or falls while it is low
            self._count(up=second == first)

    def _count(self, *, up: bool) -> None:
        timer = self.tim3
        top, count = timer[ARR] & 0xFFFF, timer[CNT] & 0xFFFF
        if up:
            timer[CNT] = 0 if count >= top else count + 1
        else:
            timer[CNT] = top if count == 0 else count - 1
        timer[CR1] = timer[CR1] & ~0x10 | (0 if up else 0x10)

    # ---- serial line and DMA --------------------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        """Bytes on the line, beginning now or behind those that are on their way."""
        byte_s = BITS_OF_A_BYTE / self._baud
        at = max(self.time_s, self._in[-1][0] if self._in else 0.0)
        for byte in data:
            at += byte_s
            self._in.append((at, byte))

    def sent(self) -> bytes:
        sent = bytes(self._sent)
        self._sent.clear()
        return sent

    def _channel(self, number: int) -> int:
        return 0x08 + 20 * (number - 1)

    def _write_dma(self, offset: int, value: int) -> None:
        number, register = (offset - 0x08) // 20 + 1, (offset - 0x08) % 20
        base = self._channel(number)
        if register and self.dma[base] & 1:
            return  # locked while the channel is on
        began = register == 0 and value & 1 and not self.dma[base] & 1
        self.dma[offset] = value
        if not began:
            if register == 0 and number == TX_CHANNEL and not value & 1:
                self._out_at = NEVER
            return
        if number not in self._reload or self.dma[base + 8] != self.usart.base + USART_DR:
            raise ChipError(f"DMA channel {number} serves what is not modelled")
        if value & 0x4F00 or not value & 0x80 or bool(value & 0x10) != (number == TX_CHANNEL):
            raise ChipError(f"DMA channel {number} is in a mode that is not modelled")
        self._reload[number] = self.dma[base + 4]
        if number == TX_CHANNEL and self.dma[base + 4]:
            self._check_line(0x2008, 0x80)
            self._out_at = self.time_s + BITS_OF_A_BYTE / self.line_baud

    def _check_line(self, enabled: int, by_dma: int) -> None:
        if self.usart[USART_CR1] & enabled != enabled or not self.usart[USART_CR3] & by_dma:
            raise ChipError("the serial line is not on, or not served by DMA")
        if abs(self.line_baud / self._baud - 1.0) > 0.02:
            raise ChipError(f"the chip's line runs at {self.line_baud:.0f} Bd, the other end at {self._baud} Bd")

    def _byte_out(self) -> None:
        base = self._channel(TX_CHANNEL)
        left = self.dma[base + 4]
        self._sent += self._read_memory(self.dma[base + 12] + self._reload[TX_CHANNEL] - left, 1)
        self.dma[base + 4] = left - 1
        self._out_at = self._out_at + BITS_OF_A_BYTE / self.line_baud if left > 1 else NEVER

    def _byte_in(self, byte: int) -> None:
        base = self._channel(RX_CHANNEL)
        if not self._is_clocked(self.usart) or not self.usart[USART_CR1] & 4:
            return  # nobody listens
        self._check_line(0x2004, 0x40)
        left = self.dma[base + 4]
        if not self.dma[base] & 1 or not left:
            return
        self._write_memory(self.dma[base + 12] + self._reload[RX_CHANNEL] - left, bytes([byte]))
        left -= 1
        self.dma[base + 4] = self._reload[RX_CHANNEL] if left == 0 and self.dma[base] & 0x20 else left

    # ---- time -----------------------------------------------------------------------------------------------------

    def _write_core(self, offset: int, value: int) -> None:
        if offset == ICSR:
            if value >> 25 & 1:
                self.pending = False
            if value >> 26 & 1:
                self.pending = True
            return
        self.core[offset] = 0 if offset == CVR else value
        on = self.core[CSR] & 1
        if on and (offset == CVR or (offset == CSR and self._tick_at == NEVER)):
            self._tick_at = self.time_s + self._tick_s
        if not on:
            self._tick_at = NEVER

    @property
    def _tick_s(self) -> float:
        hertz = self.core_hz / (1 if self.core[CSR] >> 2 & 1 else 8)
        return ((self.core[RVR] & 0xFFFFFF) + 1) / hertz

    def _write_watchdog(self, offset: int, value: int) -> None:
        if offset == KR:
            self._unlocked = value == 0x5555
            if value == 0xCCCC or (value == 0xAAAA and self._starve_at != NEVER):
                reload = self.iwdg[RLR] & 0xFFF if RLR in self.iwdg.words else 0xFFF
                self._starve_at = self.time_s + (4 << min(self.iwdg[PR] & 7, 6)) * (reload + 1) / LSI_HZ
        elif self._unlocked:
            self.iwdg[offset] = value

    def next_event_s(self) -> float:
        """When something happens by itself."""
        return min(self._tick_at, self._starve_at, self._out_at, self._in[0][0] if self._in else NEVER)

    def pass_time(self, until_s: float) -> None:
        """Let time pass up to *until_s*, or to where the core would wake."""
        while True:
            at = self.next_event_s()
            if at > until_s:
                self.time_s = max(self.time_s, until_s)
                return
            self.time_s = max(self.time_s, at)
            if at == self._out_at:
                self._byte_out()
            elif self._in and at == self._in[0][0]:
                self._byte_in(self._in.popleft()[1])
            elif at == self._starve_at:
                self.starved = True
                self._starve_at = NEVER
                return
            else:
                self._tick_at += self._tick_s
                if self.core[CSR] & 2:
                    self.pending = True
                    return


TIM2_PINS = ("PA0", "PA1", "PA2", "PA3")

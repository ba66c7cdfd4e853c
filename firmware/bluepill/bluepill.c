/* Blue Pill (STM32F103C8, 72 MHz): the registers of the board. No interrupt is ever taken: the encoder, the PWM and
 * both directions of the serial line run by themselves, and the core sleeps from one task step to the next.
 *
 *   PA9, PA10  serial line, 500 kBd, through a USB adapter of 3.3 V
 *   PA6, PA7   encoder A, B (TIM3; these two pins do not stand 5 V)
 *   PA3        PWM, 20 kHz, 3600 steps (TB6612: PWM, L298N: ENA); with FIO_IN_IN PA2, PA3 are IN1, IN2
 *   PB12, PB13 IN1, IN2
 *   PB14       enable (TB6612: STBY, DRV8833: nSLEEP), high once the lines say brake
 *   PC13       the LED, lit (low) while the task runs
 */
#include "board.h"
#include "registers.h"

#define CORE_HZ 72000000u
#define BAUD 500000u

#define RING 512u /* bytes that came; a line at 500 kBd brings 250 in a step */

#define IN1 (1u << 12)
#define IN2 (1u << 13)
#define ENABLE (1u << 14)
#define LED (1u << 13)
#define OFF(bits) ((bits) << 16) /* in BSRR */

static struct fio_board board;
static volatile uint8_t ring[RING];
static uint8_t out[FIO_OUT_BYTES];

static void start_clock(void)
{
    FLASH_ACR = 0x12u;              /* two wait states, prefetch */
    RCC_CR |= 1u << 16;             /* crystal on */
    while (!(RCC_CR & (1u << 17)))
        ;
    RCC_CFGR = 7u << 18 | 1u << 16 | 4u << 8; /* 8 MHz crystal times 9; APB1 at half of that */
    RCC_CR |= 1u << 24;             /* PLL on */
    while (!(RCC_CR & (1u << 25)))
        ;
    RCC_CFGR |= 2u;
    while ((RCC_CFGR & 0xCu) != 8u)
        ;
    RCC_AHBENR |= 1u;                                        /* DMA1 */
    RCC_APB2ENR |= 1u << 14 | 1u << 4 | 1u << 3 | 1u << 2;   /* USART1, ports C, B, A */
    RCC_APB1ENR |= 3u;                                       /* TIM2, TIM3 */
}

static void put(const struct fio_lines *lines)
{
#if FIO_BRIDGE == FIO_IN_IN
    TIM2_CCR3 = lines->in1;
    TIM2_CCR4 = lines->in2;
#else
    GPIOB_BSRR = (lines->in1 ? IN1 : OFF(IN1)) | (lines->in2 ? IN2 : OFF(IN2)); /* both at once */
    TIM2_CCR4 = lines->pwm;
#endif
}

static void start_bridge(const struct fio_lines *lines)
{
    TIM2_PSC = 0;
    TIM2_ARR = FIO_STEPS - 1;
    TIM2_CCMR2 = 0x6868u; /* channels 3 and 4: PWM mode 1, new values at the end of a period */
    TIM2_CCER = 1u << 12 | (FIO_BRIDGE == FIO_IN_IN ? 1u << 8 : 0u);
    put(lines);
    TIM2_EGR = 1u;
    TIM2_CR1 = 0x81u;
    /* Until here no pin drives, and the bridge is off by its pull-downs. */
#if FIO_BRIDGE == FIO_IN_IN
    GPIOA_CRL = 0x8844BB44u; /* PA6, PA7 inputs with pull-ups; PA3, PA2 timer outputs */
    GPIOB_CRH = 0x43444444u; /* PB14 */
#else
    GPIOA_CRL = 0x8844B444u;
    GPIOB_CRH = 0x43334444u; /* PB14, PB13, PB12 */
#endif
    GPIOB_BSRR = ENABLE;
    GPIOC_CRH = 0x44244444u;
}

static void start_encoder(void)
{
    GPIOA_ODR = 1u << 6 | 1u << 7 | 1u << 10; /* pull-ups: encoder, serial input */
    TIM3_CCMR1 = 0x3131u; /* both inputs, eight samples at 72 MHz alike */
    TIM3_SMCR = 3u;       /* counts the edges of both */
    TIM3_ARR = FIO_COUNTS_PER_REV - 1;
    TIM3_CNT = 0;
    TIM3_CR1 = 1u;
}

static void start_line(void)
{
    GPIOA_CRH = 0x444448B4u; /* PA9 output, PA10 input with pull-up */
    USART1_BRR = CORE_HZ / BAUD;
    USART1_CR3 = 0xC0u; /* by DMA, both ways */
    DMA1_CPAR5 = USART1_DR_ADDRESS;
    DMA1_CMAR5 = (uint32_t)(uintptr_t)ring;
    DMA1_CNDTR5 = RING;
    DMA1_CCR5 = 0xA1u; /* bytes into memory, round and round */
    DMA1_CPAR4 = USART1_DR_ADDRESS;
    USART1_CR1 = 0x200Cu;
}

static void send(uint32_t count)
{
    DMA1_CCR4 = 0;
    DMA1_CMAR4 = (uint32_t)(uintptr_t)out;
    DMA1_CNDTR4 = count;
    DMA1_CCR4 = 0x91u; /* bytes from memory */
}

static void start_steps(void)
{
    SYST_RVR = CORE_HZ / 1000u * FIO_STEP_MS - 1;
    SYST_CVR = 0;
    SYST_CSR = 7u; /* at 72 MHz; its exception wakes the core, and is never taken */
    DBGMCU_CR |= 1u; /* a debugger reaches the core in its sleep */
    IWDG_KR = 0x5555u; /* a program that hangs starts anew, braked: 40 kHz / 8 / 500 = 10 Hz */
    IWDG_PR = 1u;
    IWDG_RLR = 500u;
    IWDG_KR = 0xCCCCu;
}

int main(void)
{
    uint32_t taken = 0;

    __asm__ volatile("cpsid i");
    start_clock();
    fio_board_init(&board);
    struct fio_lines lines = fio_board_latch(&board);
    start_bridge(&lines);
    start_encoder();
    start_line();
    start_steps();

    for (;;) {
        __asm__ volatile("dsb\n\twfi" ::: "memory");
        if (!(SCB_ICSR & (1u << 26)))
            continue;
        SCB_ICSR = 1u << 25;
        GPIOC_BSRR = OFF(LED);
        IWDG_KR = 0xAAAAu;
        for (uint32_t here = RING - DMA1_CNDTR5; taken != here; taken = (taken + 1) % RING)
            fio_board_receive(&board, ring[taken]);
        lines = fio_board_latch(&board);
        put(&lines);
        uint8_t down = TIM3_CR1 >> 4 & 1u;
        send(fio_board_report(&board, down, (uint16_t)TIM3_CNT, 0, out));
        GPIOC_BSRR = LED;
    }
}

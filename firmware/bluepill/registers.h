/* Registers of the STM32F103 that this program uses, from the reference manual RM0008 and the Cortex-M3 manual PM0056. */
#ifndef FIO_REGISTERS_H
#define FIO_REGISTERS_H

#include <stdint.h>

#define REG(address) (*(volatile uint32_t *)(address))

/* reset and clock control */
#define RCC_CR REG(0x40021000u)
#define RCC_CFGR REG(0x40021004u)
#define RCC_AHBENR REG(0x40021014u)
#define RCC_APB2ENR REG(0x40021018u)
#define RCC_APB1ENR REG(0x4002101Cu)
#define FLASH_ACR REG(0x40022000u)

/* ports */
#define GPIOA_CRL REG(0x40010800u)
#define GPIOA_CRH REG(0x40010804u)
#define GPIOA_ODR REG(0x4001080Cu)
#define GPIOB_CRH REG(0x40010C04u)
#define GPIOB_BSRR REG(0x40010C10u)
#define GPIOC_CRH REG(0x40011004u)
#define GPIOC_BSRR REG(0x40011010u)

/* timers 2 (PWM) and 3 (encoder) */
#define TIM2_CR1 REG(0x40000000u)
#define TIM2_EGR REG(0x40000014u)
#define TIM2_CCMR2 REG(0x4000001Cu)
#define TIM2_CCER REG(0x40000020u)
#define TIM2_PSC REG(0x40000028u)
#define TIM2_ARR REG(0x4000002Cu)
#define TIM2_CCR3 REG(0x4000003Cu)
#define TIM2_CCR4 REG(0x40000040u)
#define TIM3_CR1 REG(0x40000400u)
#define TIM3_SMCR REG(0x40000408u)
#define TIM3_CCMR1 REG(0x40000418u)
#define TIM3_CNT REG(0x40000424u)
#define TIM3_ARR REG(0x4000042Cu)

/* serial line 1 and its DMA channels: 4 sends, 5 receives */
#define USART1_DR_ADDRESS 0x40013804u
#define USART1_BRR REG(0x40013808u)
#define USART1_CR1 REG(0x4001380Cu)
#define USART1_CR3 REG(0x40013814u)
#define DMA1_CCR4 REG(0x40020044u)
#define DMA1_CNDTR4 REG(0x40020048u)
#define DMA1_CPAR4 REG(0x4002004Cu)
#define DMA1_CMAR4 REG(0x40020050u)
#define DMA1_CCR5 REG(0x40020058u)
#define DMA1_CNDTR5 REG(0x4002005Cu)
#define DMA1_CPAR5 REG(0x40020060u)
#define DMA1_CMAR5 REG(0x40020064u)

/* core: system timer, pending exceptions, independent watchdog, debug in sleep */
#define SYST_CSR REG(0xE000E010u)
#define SYST_RVR REG(0xE000E014u)
#define SYST_CVR REG(0xE000E018u)
#define SCB_ICSR REG(0xE000ED04u)
#define IWDG_KR REG(0x40003000u)
#define IWDG_PR REG(0x40003004u)
#define IWDG_RLR REG(0x40003008u)
#define DBGMCU_CR REG(0xE0042004u)

#endif

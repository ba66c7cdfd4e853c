/* The core on a computer, for tests: no board. -DFIO_STEPS_PER_PCT and -DFIO_BRIDGE choose what it is compiled as. */
#ifndef FIO_CONFIG_H
#define FIO_CONFIG_H

#define FIO_TB6612 1
#define FIO_L298N 2
#define FIO_IN_IN 3

#ifndef FIO_BRIDGE
#define FIO_BRIDGE FIO_TB6612
#endif
#ifndef FIO_STEPS_PER_PCT
#define FIO_STEPS_PER_PCT 36u
#endif
#define FIO_BOARD_NAME "host"
#define FIO_COUNTS_PER_REV 720u

#endif

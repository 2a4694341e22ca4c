/* A wall clock that a test can set, for LD_PRELOAD: CLOCK_REALTIME plus as many nanoseconds as stand
 * (int64) in the file that SURG_SET_CLOCK names. The steady clock and all sleeping stay as they are,
 * as when a person or NTP sets a machine's clock.
 *
 * libfaketime would do the same, but Debian 12's cannot let the steady clock alone: Python's
 * time.sleep then ends with EINVAL. */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SECOND 1000000000LL

static const volatile int64_t *moved;

__attribute__((constructor)) static void find_file(void) {
  const char *name = getenv("SURG_SET_CLOCK");
  const int file = name == NULL ? -1 : open(name, O_RDONLY | O_CLOEXEC);
  if (file < 0) return;
  void *place = mmap(NULL, sizeof *moved, PROT_READ, MAP_SHARED, file, 0);
  close(file);
  if (place != MAP_FAILED) moved = place;
}

int clock_gettime(clockid_t clock, struct timespec *found) {
  const int failed = (int)syscall(SYS_clock_gettime, clock, found);
  const int wall = clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE;
  if (failed != 0 || !wall || moved == NULL) return failed;
  const int64_t ns = found->tv_sec * SECOND + found->tv_nsec + *moved;
  found->tv_sec = ns / SECOND;
  found->tv_nsec = ns % SECOND;
  return 0;
}

int gettimeofday(struct timeval *restrict found, void *restrict zone) {
  (void)zone;
  struct timespec now;
  if (clock_gettime(CLOCK_REALTIME, &now) != 0) return -1;
  found->tv_sec = now.tv_sec;
  found->tv_usec = now.tv_nsec / 1000;
  return 0;
}

time_t time(time_t *found) {
  struct timespec now;
  if (clock_gettime(CLOCK_REALTIME, &now) != 0) return -1;
  if (found != NULL) *found = now.tv_sec;
  return now.tv_sec;
}

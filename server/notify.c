#include "server/notify.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

enum { FIRST_PASSED = 3 };

void lod_notify(const char *state) {
  const char *path = getenv("NOTIFY_SOCKET");
  struct sockaddr_un address = {.sun_family = AF_UNIX};
  size_t size = path ? strlen(path) : 0;
  if (size < 2 || size >= sizeof address.sun_path || (path[0] != '/' && path[0] != '@'))
    return;
  memcpy(address.sun_path, path, size);
  if (path[0] == '@') /* the abstract name space */
    address.sun_path[0] = 0;
  int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (fd < 0)
    return;
  ssize_t ignored = sendto(fd, state, strlen(state), MSG_NOSIGNAL, (struct sockaddr *)&address,
                           (socklen_t)(offsetof(struct sockaddr_un, sun_path) + size));
  (void)ignored; /* a manager that does not listen is its own problem */
  close(fd);
}

void lod_notify_reloading(void) {
  char text[80];
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  snprintf(text, sizeof text, "RELOADING=1\nMONOTONIC_USEC=%lld", (long long)now.tv_sec * 1000000 + now.tv_nsec / 1000);
  lod_notify(text);
}

/* Whether a variable names this process. */
static int is_ours(const char *name) {
  const char *text = getenv(name);
  return text && strtol(text, NULL, 10) == (long)getpid();
}

int lod_notify_take_listener(void) {
  const char *count = getenv("LISTEN_FDS");
  int fd = is_ours("LISTEN_PID") && count && strtol(count, NULL, 10) >= 1 ? FIRST_PASSED : -1;
  unsetenv("LISTEN_PID");
  unsetenv("LISTEN_FDS");
  unsetenv("LISTEN_FDNAMES");
  return fd;
}

double lod_notify_watchdog_seconds(void) {
  const char *text = getenv("WATCHDOG_USEC");
  if (!text || (getenv("WATCHDOG_PID") && !is_ours("WATCHDOG_PID")))
    return 0;
  return 1e-6 * strtod(text, NULL);
}

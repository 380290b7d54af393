/* A worker for the tests of the queue: the upload's text says what it shall do. */
#ifndef LOD_TESTS_FAKE_WORKER_H
#define LOD_TESTS_FAKE_WORKER_H

#include <signal.h>
#include <sys/resource.h>
#include <time.h>

#include "server/jobs/frame.h"
#include "tests/unit/server/store/bake_folder.h"

#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define SANITIZED 1
#endif
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

static const struct bake_level kCube[] = {{"coarse cube", 0}, {"fine cube", 0}};

static void send_text(char type, const char *text) {
  if (lod_frame_write(LOD_WORKER_SOCKET_FD, type, text, strlen(text)) != LOD_OK)
    _exit(9);
}

static void succeed(const char *revision) {
  send_text('P', "{\"stage\":\"import\",\"progress\":0.25}");
  if (write_bake(LOD_WORKER_OUTPUT_FD, "bunny", revision, kCube, 2, NULL) != 0)
    _exit(8);
  send_text('D', "{}");
}

static void wait_forever(void) {
  for (;;)
    pause();
}

static void do_succeed(const char *rest) {
  succeed(rest);
}
static void do_succeed_slowly(const char *rest) {
  send_text('P', "{\"stage\":\"slow\",\"progress\":0}");
  nanosleep(&(struct timespec){.tv_nsec = 400000000}, NULL);
  succeed(rest);
}
static void do_succeed_and_stay(const char *rest) {
  (void)rest;
  succeed("r1");
  wait_forever();
}
static void do_succeed_and_crash(const char *rest) {
  (void)rest;
  succeed("r1");
  signal(SIGSEGV, SIG_DFL);
  kill(getpid(), SIGSEGV);
}
static void do_signal(const char *rest) {
  fprintf(stderr, "last words\x1b[31m of %s\n", rest);
  signal(atoi(rest), SIG_DFL);
  kill(getpid(), atoi(rest));
  wait_forever();
}
static void do_exit(const char *rest) {
  _exit(atoi(rest));
}
static void do_hang(const char *rest) {
  (void)rest;
  signal(SIGTERM, SIG_IGN);
  if (fork() == 0) /* and so does a child of its own */
    wait_forever();
  wait_forever();
}
static void do_spin(const char *rest) {
  (void)rest;
  for (volatile unsigned i = 0;;)
    i = i + 1;
}
static void do_flood(const char *rest) {
  for (;;)
    send_text(rest[0], rest + 1);
}
static void do_say(const char *rest) {
  send_text(rest[0], rest + 1);
  wait_forever();
}
static void do_raw(const char *rest) {
  if (write(LOD_WORKER_SOCKET_FD, rest, strlen(rest)) < 0)
    _exit(9);
  wait_forever();
}
static void do_fail(const char *rest) {
  (void)rest;
  send_text('F', "{\"status\":\"bad-input\",\"type\":\"truncated\",\"detail\":\"The file ends\\nin the middle.\"}");
}
static void do_close(const char *rest) {
  (void)rest;
  close(LOD_WORKER_SOCKET_FD);
  wait_forever();
}
static void do_log(const char *rest) {
  (void)rest;
  char line[1024];
  memset(line, 'l', sizeof line);
  for (int i = 0; i < 5000; i++)
    if (write(2, line, sizeof line) < 0)
      _exit(9);
  succeed("r1");
}
static void do_eat_memory(const char *rest) {
  (void)rest;
  for (;;) {
    char *block = malloc(1 << 20);
    if (block == NULL)
      abort();
    memset(block, 1, 1 << 20);
  }
}
/* "1": one file, else many. */
static void do_fill_disk(const char *rest) {
  static char block[1 << 20];
  for (int i = 0;; i++) {
    char name[32];
    snprintf(name, sizeof name, "file-%d", atoi(rest) == 1 ? 0 : i);
    int fd = openat(LOD_WORKER_OUTPUT_FD, name, O_WRONLY | O_CREAT | O_APPEND, 0600);
    for (int k = 0; k < 8; k++)
      if (write(fd, block, sizeof block) < 0)
        _exit(9);
    close(fd);
  }
}
static void do_lie(const char *rest) {
  (void)rest;
  if (write_bake(LOD_WORKER_OUTPUT_FD, "bunny", "r1", kCube, 2, NULL) != 0)
    _exit(8);
  char name[80] = "objects/";
  lod_sha256_text(kCube[0].content, strlen(kCube[0].content), name + strlen(name));
  if (write_file_at(LOD_WORKER_OUTPUT_FD, name, "other bytes", 11) != 0)
    _exit(8);
  send_text('D', "{}");
}
static void do_nothing_but_done(const char *rest) {
  (void)rest;
  send_text('D', "{}");
}

/* Exit status 20 and more: the first thing that is not as it should be. */
static void do_look_around(const char *rest) {
  (void)rest;
  for (int fd = 0; fd <= 5; fd++)
    if (fcntl(fd, F_GETFD) < 0)
      _exit(20);
  for (int fd = 6; fd < 1024; fd++)
    if (fcntl(fd, F_GETFD) >= 0)
      _exit(21);
  if ((fcntl(LOD_WORKER_INPUT_FD, F_GETFL) & O_ACCMODE) != O_RDONLY)
    _exit(22);
  if (getpgrp() != getpid() || getenv("HOME") != NULL || getenv("TEST_SECRET") != NULL)
    _exit(23);
  sigset_t set;
  sigprocmask(SIG_SETMASK, NULL, &set);
  if (sigismember(&set, SIGTERM) || signal(SIGPIPE, SIG_DFL) != SIG_DFL)
    _exit(24);
  struct rlimit core, files, data, cpu;
  getrlimit(RLIMIT_CORE, &core);
  getrlimit(RLIMIT_NOFILE, &files);
  getrlimit(RLIMIT_DATA, &data);
  getrlimit(RLIMIT_CPU, &cpu);
  if ((!SANITIZED && core.rlim_max != 0) || files.rlim_max > 64 || (!SANITIZED && data.rlim_max != 64 << 20) ||
      cpu.rlim_max == RLIM_INFINITY)
    _exit(25);
  succeed("r1");
}

/* Slow and failing, or quick, by the families that are asked for; the revision says which they were. */
static char families[64];
static void do_families(const char *rest) {
  if (strstr(families, "envelope") != NULL && strncmp(rest, "late-", 5) == 0) {
    send_text('P', "{\"stage\":\"slow\",\"progress\":0}");
    if (strcmp(rest, "late-hang") == 0)
      wait_forever();
    do_fail(rest);
    return;
  }
  succeed(families);
}

struct role {
  const char *name;
  void (*act)(const char *rest);
};
static const struct role kRoles[] = {
    {"succeed ", do_succeed},
    {"slowly ", do_succeed_slowly},
    {"succeed-and-stay", do_succeed_and_stay},
    {"succeed-and-crash", do_succeed_and_crash},
    {"signal ", do_signal},
    {"exit ", do_exit},
    {"hang", do_hang},
    {"spin", do_spin},
    {"flood ", do_flood},
    {"say ", do_say},
    {"raw ", do_raw},
    {"fail", do_fail},
    {"close", do_close},
    {"log", do_log},
    {"eat-memory", do_eat_memory},
    {"fill-disk ", do_fill_disk},
    {"lie", do_lie},
    {"nothing-but-done", do_nothing_but_done},
    {"look-around", do_look_around},
    {"families ", do_families},
};

static int act_as_worker(void) {
  char text[256] = {0}, type;
  struct lod_frame_reader reader = {0};
  bool read = lod_frame_read(LOD_WORKER_SOCKET_FD, &reader, &type) == LOD_OK && type == 'J';
  if (read && strstr(reader.payload, "\"job\":\"try\"") != NULL) {
    send_text('D', "{}");
    return 0;
  }
  if (!read || strstr(reader.payload, "\"job\":\"bake\"") == NULL || pread(LOD_WORKER_INPUT_FD, text, sizeof text - 1, 0) < 0)
    return 99;
  const char *list = strstr(reader.payload, "\"families\":[");
  for (size_t i = 0; list != NULL && list[12 + i] != ']' && i < sizeof families - 1; i++)
    families[i] = list[12 + i] == '"' || list[12 + i] == ',' ? '-' : list[12 + i];
  lod_frame_reader_finish(&reader);
  for (size_t i = 0; i < sizeof kRoles / sizeof kRoles[0]; i++)
    if (strncmp(text, kRoles[i].name, strlen(kRoles[i].name)) == 0) {
      kRoles[i].act(text + strlen(kRoles[i].name));
      return 0;
    }
  return 98;
}

#endif

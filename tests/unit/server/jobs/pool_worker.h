/* A warm worker for tests: each request's parameter "role" says what it shall do. The test program is its own worker. */
#ifndef LOD_TESTS_POOL_WORKER_H
#define LOD_TESTS_POOL_WORKER_H

#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/jobs/frame.h"

static struct lod_frame_reader pool_reader;

static void pool_send(char type, const void *bytes, size_t size) {
  for (size_t at = 0; at < size || size == 0; at += LOD_FRAME_MAX) {
    size_t piece = size - at < LOD_FRAME_MAX ? size - at : LOD_FRAME_MAX;
    if (lod_frame_write(LOD_WORKER_SOCKET_FD, type, (const char *)bytes + at, piece) != LOD_OK)
      _exit(9);
    if (size == 0)
      break;
  }
}

static void pool_facts(size_t bytes) {
  char text[96];
  pool_send('R', text, (size_t)snprintf(text, sizeof text, "{\"bytes\":%zu,\"pid\":%d}", bytes, (int)getpid()));
}

static void pool_answer(const void *bytes, size_t size) {
  pool_facts(size);
  if (size != 0)
    pool_send('G', bytes, size);
}

/* The next frames of one type, together `size` bytes. */
static char *pool_receive(char type, size_t size) {
  char *bytes = malloc(size + 1), got;
  for (size_t at = 0; at < size; at += pool_reader.payload_size) {
    if (lod_frame_read(LOD_WORKER_SOCKET_FD, &pool_reader, &got) != LOD_OK || got != type || pool_reader.payload_size > size - at)
      _exit(10);
    memcpy(bytes + at, pool_reader.payload, pool_reader.payload_size);
  }
  return bytes;
}

static size_t pool_number(const char *json, const char *name) {
  const char *at = strstr(json, name);
  return at == NULL ? 0 : strtoul(at + strlen(name) + 2, NULL, 10);
}

static void pool_wait_to_stop(void) {
  struct pollfd fd = {LOD_WORKER_SOCKET_FD, POLLIN, 0};
  poll(&fd, 1, -1);
}

static void pool_play(const char *role, size_t base, size_t values) {
  if (strcmp(role, "echo") == 0) { /* values, then the base */
    char *v = pool_receive('V', values);
    pool_send('N', "{}", 2);
    char *b = pool_receive('B', base), *both = malloc(base + values);
    memcpy(both, v, values);
    memcpy(both + values, b, base);
    pool_answer(both, base + values);
    free(v);
    free(b);
    free(both);
  } else if (strcmp(role, "large") == 0) {
    size_t size = 3 * LOD_FRAME_MAX + 5;
    char *bytes = malloc(size);
    for (size_t i = 0; i < size; i++)
      bytes[i] = (char)(i % 251);
    pool_answer(bytes, size);
    free(bytes);
  } else if (strcmp(role, "quick") == 0) {
    pool_answer("quick", 5);
  } else if (strcmp(role, "empty") == 0) {
    pool_answer("", 0);
  } else if (strcmp(role, "stop") == 0) {
    pool_wait_to_stop();
    static const char kStopped[] = "{\"status\":\"cancelled\",\"type\":\"cancelled\",\"detail\":\"Stopped.\",\"parameter\":\"\"}";
    pool_send('F', kStopped, sizeof kStopped - 1);
  } else if (strcmp(role, "fail") == 0) {
    static const char kFailed[] =
        "{\"status\":\"bad-input\",\"type\":\"bad-parameter\",\"detail\":\"No such part.\",\"parameter\":\"part\"}";
    pool_send('F', kFailed, sizeof kFailed - 1);
  } else if (strcmp(role, "hang") == 0) {
    for (;;)
      pause();
  } else if (strcmp(role, "signal") == 0) {
    signal(SIGSEGV, SIG_DFL);
    kill(getpid(), SIGSEGV);
    pause();
  } else if (strcmp(role, "exit") == 0) {
    _exit(3);
  } else if (strcmp(role, "half") == 0) {
    pool_facts(10);
    pool_send('G', "12345", 5);
    _exit(0);
  } else if (strcmp(role, "more") == 0) {
    pool_facts(3);
    pool_send('G', "12345", 5);
    pause();
  } else if (strcmp(role, "twice") == 0) {
    pool_facts(3);
    pool_facts(3);
    pause();
  } else if (strcmp(role, "negative") == 0) {
    pool_send('R', "{\"bytes\":-1}", 12);
    pause();
  } else if (strcmp(role, "strange") == 0) {
    pool_send('?', "x", 1);
    pause();
  } else if (strcmp(role, "leave") == 0) { /* answers, and is gone before the next request */
    pool_answer("left", 4);
    _exit(0);
  }
}

static int act_as_pool_worker(void) {
  char type;
  if (lod_frame_read(LOD_WORKER_SOCKET_FD, &pool_reader, &type) != LOD_OK || type != 'J' ||
      strstr(pool_reader.payload, "\"job\":\"refine\"") == NULL)
    return 99;
  while (lod_frame_read(LOD_WORKER_SOCKET_FD, &pool_reader, &type) == LOD_OK) {
    char role[32] = "";
    const char *at = type == 'Q' ? strstr(pool_reader.payload, "\"role\":\"") : NULL;
    if (type == 'X')
      continue;
    if (at == NULL || sscanf(at, "\"role\":\"%31[a-z]", role) != 1)
      return 98;
    pool_play(role, pool_number(pool_reader.payload, "\"base_bytes"), pool_number(pool_reader.payload, "\"values_bytes"));
  }
  return 0;
}

#endif

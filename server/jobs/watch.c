#include "server/jobs/watch.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "server/jobs/frame.h"

/* Frames handled before the clock is looked at again: a worker that floods us still meets its deadline. */
enum { FRAMES_AT_ONCE = 64, TICK_MS = 500, OUTPUT_DEPTH = 4, OUTPUT_FILES = 100000 };
static const double kGraceSeconds = 2; /* for leaving after the answer */
static const double kProgressSeconds = 0.1;

struct talk {
  const struct lod_watch *watch;
  struct lod_watch_result *result;
  struct lod_process process;
  struct lod_frame_reader reader;
  bool answered, socket_ended;
  bool over; /* `end` is decided */
  double started, reported;
  char stage[32];
  size_t log_size;
};

static double seconds_now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

static void end(struct talk *talk, enum lod_watch_end how) {
  if (!talk->over)
    talk->result->end = how;
  talk->over = true;
}

static void protocol_error(struct talk *talk, const char *what) {
  end(talk, LOD_WATCH_CRASHED);
  (void)lod_fail(&talk->result->problem, LOD_IO, "worker-protocol", "The worker process %s.", what);
}

/* ---- what the worker says ---- */

static void copy_printable(char *to, size_t size, const char *from) {
  size_t i = 0;
  for (; i + 1 < size && from[i] != 0; i++)
    to[i] = (unsigned char)from[i] < 0x20 || from[i] == 0x7f ? ' ' : from[i];
  /* Not in the middle of a UTF-8 sequence. */
  if (from[i] != 0)
    while (i > 0 && ((unsigned char)from[i] & 0xc0) == 0x80)
      i--;
  to[i] = 0;
}

static bool is_problem_type(const char *type) {
  size_t length = strlen(type);
  return length > 0 && length < sizeof((struct lod_problem *)0)->type && strspn(type, "abcdefghijklmnopqrstuvwxyz0123456789-") == length;
}

static bool take_failure(struct talk *talk, const json_t *json) {
  const char *status = json_string_value(json_object_get(json, "status"));
  const char *type = json_string_value(json_object_get(json, "type"));
  const char *detail = json_string_value(json_object_get(json, "detail"));
  if (status == NULL || type == NULL || detail == NULL || !is_problem_type(type))
    return false;
  struct lod_problem *problem = &talk->result->problem;
  for (int code = LOD_BAD_INPUT; code <= LOD_CANCELLED; code++)
    if (strcmp(status, lod_status_name((enum lod_status)code)) == 0)
      problem->status = (enum lod_status)code;
  if (problem->status == LOD_OK)
    return false;
  snprintf(problem->type, sizeof problem->type, "%s", type);
  copy_printable(problem->detail, sizeof problem->detail, detail);
  return true;
}

static bool take_progress(struct talk *talk, const json_t *json) {
  const char *stage = json_string_value(json_object_get(json, "stage"));
  const json_t *progress = json_object_get(json, "progress");
  double fraction = json_number_value(progress);
  if (stage == NULL || !json_is_number(progress) || !(fraction >= 0 && fraction <= 1))
    return false;
  char text[sizeof talk->stage];
  copy_printable(text, sizeof text, stage);
  double time = seconds_now();
  if (talk->watch->progress != NULL && (strcmp(text, talk->stage) != 0 || time - talk->reported >= kProgressSeconds)) {
    memcpy(talk->stage, text, sizeof text);
    talk->reported = time;
    talk->watch->progress(talk->watch->context, text, fraction);
  }
  return true;
}

static void take_frame(struct talk *talk, char type) {
  json_error_t error;
  json_t *json = json_loadb(talk->reader.payload, talk->reader.payload_size, JSON_REJECT_DUPLICATES, &error);
  bool understood = false;
  if (json_is_object(json) && type == 'P')
    understood = take_progress(talk, json);
  else if (json_is_object(json) && type == 'F')
    understood = talk->answered = take_failure(talk, json);
  else if (json_is_object(json) && type == 'D')
    understood = talk->answered = true;
  json_decref(json);
  if (talk->answered)
    end(talk, type == 'D' ? LOD_WATCH_DONE : LOD_WATCH_FAILED);
  if (!understood)
    protocol_error(talk, "sent what is not a frame of the protocol");
}

/* all: until nothing is left, for a worker that has ended. */
static void read_frames(struct talk *talk, bool all) {
  for (int i = 0; (all || i < FRAMES_AT_ONCE) && !talk->over; i++) {
    char type;
    enum lod_status status = lod_frame_read(talk->process.socket_fd, &talk->reader, &type);
    if (status == LOD_IO)
      talk->socket_ended = true;
    if (status == LOD_BAD_INPUT || status == LOD_MEMORY)
      protocol_error(talk, "sent what is not a frame of the protocol");
    if (status != LOD_OK || type == 0)
      return;
    take_frame(talk, type);
  }
}

/* Keeps the last LOD_WATCH_LOG_BYTES. False at the end of file. */
static bool read_log(struct talk *talk) {
  char chunk[LOD_WATCH_LOG_BYTES];
  char *log = talk->result->log;
  for (int i = 0; i < FRAMES_AT_ONCE; i++) {
    ssize_t got = read(talk->process.log_fd, chunk, sizeof chunk);
    if (got < 0 && (errno == EAGAIN || errno == EINTR))
      return true;
    if (got <= 0)
      return false;
    size_t size = (size_t)got;
    size_t excess = talk->log_size + size > LOD_WATCH_LOG_BYTES ? talk->log_size + size - LOD_WATCH_LOG_BYTES : 0;
    memmove(log, log + excess, talk->log_size - excess);
    talk->log_size -= excess;
    for (size_t k = 0; k < size; k++)
      log[talk->log_size++] = chunk[k] == '\n' || (chunk[k] >= 0x20 && chunk[k] < 0x7f) ? chunk[k] : '?';
  }
  return true;
}

/* ---- limits that no rlimit states ---- */

static uint64_t folder_bytes(int parent_fd, const char *name, int depth, unsigned *files) {
  if (depth == 0)
    return UINT64_MAX / 2;
  int fd = openat(parent_fd, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  DIR *folder = fd < 0 ? NULL : fdopendir(fd);
  if (folder == NULL) {
    if (fd >= 0)
      close(fd);
    return 0;
  }
  uint64_t bytes = 0;
  for (const struct dirent *file; bytes < UINT64_MAX / 4 && (file = readdir(folder)) != NULL;) {
    struct stat facts;
    if (strcmp(file->d_name, ".") == 0 || strcmp(file->d_name, "..") == 0 || fstatat(fd, file->d_name, &facts, AT_SYMLINK_NOFOLLOW) != 0)
      continue;
    if (++*files > OUTPUT_FILES)
      bytes = UINT64_MAX / 2;
    else if (S_ISDIR(facts.st_mode))
      bytes += folder_bytes(fd, file->d_name, depth - 1, files);
    else
      bytes += (uint64_t)facts.st_blocks * 512;
  }
  closedir(folder);
  return bytes;
}

static void check_limits(struct talk *talk, double time) {
  const struct lod_watch *watch = talk->watch;
  unsigned files = 0;
  if (time - talk->started > watch->deadline_seconds) {
    end(talk, LOD_WATCH_KILLED);
    (void)lod_fail(&talk->result->problem, LOD_LIMIT, "limit-seconds",
                   "The bake took longer than the limit of %.0f seconds and was stopped.", watch->deadline_seconds);
  } else if (folder_bytes(watch->spawn.output_fd, ".", OUTPUT_DEPTH, &files) > watch->output_limit_bytes) {
    end(talk, LOD_WATCH_KILLED);
    (void)lod_fail(&talk->result->problem, LOD_LIMIT, "limit-output", "The bake wrote more than the limit of %llu bytes and was stopped.",
                   (unsigned long long)watch->output_limit_bytes);
  }
}

/* ---- how it ended ---- */

struct meaning {
  int signal;
  enum lod_watch_end end;
  enum lod_status status;
  const char *type, *text;
};
static const struct meaning kMeanings[] = {
    {SIGKILL, LOD_WATCH_CRASHED, LOD_MEMORY, "worker-crashed", "killed from outside, as the kernel does when memory runs out"},
    {SIGABRT, LOD_WATCH_CRASHED, LOD_MEMORY, "worker-crashed", "an allocation beyond the memory limit or an internal check that failed"},
    {SIGSEGV, LOD_WATCH_CRASHED, LOD_IO, "worker-crashed",
     "a bad memory access: a bug that this model brings out, or no memory for the stack"},
    {SIGBUS, LOD_WATCH_CRASHED, LOD_IO, "worker-crashed",
     "a bad memory access: a bug that this model brings out, or a disk that failed or is full"},
    {SIGILL, LOD_WATCH_CRASHED, LOD_IO, "worker-crashed", "an instruction that this processor does not have, or a bug"},
    {SIGFPE, LOD_WATCH_CRASHED, LOD_IO, "worker-crashed", "a division by zero: a bug that this model brings out"},
    {SIGSYS, LOD_WATCH_CRASHED, LOD_IO, "worker-crashed", "it asked the kernel for something that its jail forbids"},
    {SIGXCPU, LOD_WATCH_KILLED, LOD_LIMIT, "limit-seconds", "it used more processor time than it may"},
    {SIGXFSZ, LOD_WATCH_KILLED, LOD_LIMIT, "limit-output", "it wrote a larger file than it may"},
};

static void explain_end(struct talk *talk, struct lod_process_end how) {
  struct lod_problem *problem = &talk->result->problem;
  end(talk, LOD_WATCH_CRASHED);
  if (how.signal == 0) {
    (void)lod_fail(problem, LOD_IO, "worker-crashed", "The worker process left with status %d without an answer.", how.code);
    return;
  }
  const char *name = sigabbrev_np(how.signal);
  for (size_t i = 0; i < sizeof kMeanings / sizeof kMeanings[0]; i++)
    if (kMeanings[i].signal == how.signal) {
      talk->result->end = kMeanings[i].end;
      (void)lod_fail(problem, kMeanings[i].status, kMeanings[i].type, "The worker process ended by SIG%s: %s.", name, kMeanings[i].text);
    }
  (void)lod_fail(problem, LOD_IO, "worker-crashed", "The worker process ended by signal %d (%s).", how.signal, name == NULL ? "?" : name);
}

/* ---- the loop ---- */

/* One round: waits for something, reads it. True while the worker may go on. */
static bool wait_once(struct talk *talk) {
  struct pollfd fds[] = {{.fd = talk->over ? -1 : talk->process.socket_fd, .events = POLLIN},
                         {.fd = talk->process.pid_fd, .events = POLLIN},
                         {.fd = talk->process.log_fd, .events = POLLIN},
                         {.fd = talk->watch->stop_fd, .events = POLLIN}};
  if (talk->socket_ended)
    fds[0].fd = -1;
  if (poll(fds, 4, talk->process.pid_fd < 0 ? TICK_MS / 10 : TICK_MS) < 0 && errno != EINTR)
    return false;
  if (fds[2].revents != 0 && !read_log(talk)) {
    close(talk->process.log_fd);
    talk->process.log_fd = -1;
  }
  if ((fds[0].revents & (POLLIN | POLLHUP | POLLERR)) != 0)
    read_frames(talk, false);
  if (fds[3].revents != 0 && !talk->over) {
    end(talk, LOD_WATCH_STOPPED);
    return false;
  }
  return !lod_process_has_ended(&talk->process);
}

static void talk_until_end(struct talk *talk) {
  double checked = talk->started, silent = 0;
  while (wait_once(talk)) {
    double time = seconds_now();
    if (talk->over && !talk->answered)
      break; /* nonsense */
    if ((talk->over || talk->socket_ended) && silent == 0)
      silent = time;
    if (silent != 0 && time - silent > kGraceSeconds) {
      if (!talk->over)
        protocol_error(talk, "closed its connection without an answer");
      break;
    }
    if (!talk->over && time - checked > TICK_MS * 0.001) {
      check_limits(talk, time);
      checked = time;
    }
  }
  if (!talk->over) /* it has ended: what it said last is still in the socket */
    read_frames(talk, true);
  if (talk->process.log_fd >= 0)
    (void)read_log(talk);
}

void lod_watch_run(const struct lod_watch *watch, struct lod_watch_result *result) {
  memset(result, 0, sizeof *result);
  struct talk talk = {.watch = watch, .result = result, .started = seconds_now()};
  if (lod_process_spawn(&watch->spawn, &talk.process, &result->problem) != LOD_OK) {
    result->end = LOD_WATCH_FAILED;
    return;
  }
  /* A write that fails means a worker that is gone already: its end says more than errno. */
  if (lod_frame_write(talk.process.socket_fd, 'J', watch->job, watch->job_size) == LOD_OK &&
      fcntl(talk.process.socket_fd, F_SETFL, O_NONBLOCK) == 0)
    talk_until_end(&talk);
  struct lod_process_end how = lod_process_finish(&talk.process);
  if (!talk.over)
    explain_end(&talk, how);
  lod_frame_reader_finish(&talk.reader);
}

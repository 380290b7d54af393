#include "server/jobs/pool.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <limits.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "server/jobs/frame.h"
#include "server/jobs/spawn.h"

enum { MAX_WORKERS = 64, CPU_SECONDS = 24 * 3600, ANSWER_MAX_BYTES = 1 << 30, LOG_LINE = 512 };
/* A worker that was told to stop and does not is ended. */
static const double kStopSeconds = 2;
/* A worker that dies at its start is not started again at once for ever. */
static const double kRestartSeconds = 1;

struct runner {
  struct lod_pool *pool;
  pthread_t thread;
  bool started;
  int wake_fd; /* eventfd: the job was cancelled, or the pool stops */
  struct lod_pool_job *job;
  bool alive;
  struct lod_process process;
  struct lod_frame_reader reader;
  double born;
};

struct lod_pool {
  struct lod_pool_settings settings;
  char *worker_path, *folder;
  pthread_mutex_t mutex;
  pthread_cond_t queued;
  struct lod_pool_job *first, **last;
  struct lod_pool_counts counts;
  bool stopping;
  struct runner runners[MAX_WORKERS];
  uint32_t runner_count;
};

struct lod_pool_settings lod_pool_defaults(void) {
  return (struct lod_pool_settings){.workers = 2, .queue_limit = 32, .deadline_seconds = 10, .memory_limit_bytes = UINT64_C(2) << 30};
}

static double monotonic(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

__attribute__((format(printf, 2, 3))) static void say(struct lod_pool *pool, const char *format, ...) {
  char line[LOG_LINE + 128];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(line, sizeof line, format, arguments);
  va_end(arguments);
  if (pool->settings.log != NULL)
    pool->settings.log(pool->settings.context, line);
  else
    fprintf(stderr, "lodestreamd: %s\n", line);
}

/* ---- a worker's life ---- */

static void drain_log(struct runner *runner) {
  char text[LOG_LINE + 1];
  ssize_t got;
  while ((got = read(runner->process.log_fd, text, LOG_LINE)) > 0) {
    text[got] = 0;
    for (ssize_t i = 0; i < got; i++)
      text[i] = text[i] == '\n' && i + 1 == got ? 0 : (unsigned char)text[i] < 0x20 || text[i] == 0x7f ? ' ' : text[i];
    say(runner->pool, "refine worker: %s", text);
  }
}

static struct lod_process_end end_worker(struct runner *runner) {
  struct lod_process_end end = {0};
  if (!runner->alive)
    return end;
  drain_log(runner);
  end = lod_process_finish(&runner->process);
  lod_frame_reader_finish(&runner->reader);
  runner->alive = false;
  pthread_mutex_lock(&runner->pool->mutex);
  runner->pool->counts.alive--;
  pthread_mutex_unlock(&runner->pool->mutex);
  return end;
}

const char *lod_pool_end_name(enum lod_pool_end end) {
  static const char *const kNames[LOD_POOL_ENDS] = {"signal", "exit", "nonsense", "deadline", "cancelled", "idle"};
  return kNames[end];
}

static void count_worker(struct lod_pool *pool, enum lod_pool_end end) {
  pthread_mutex_lock(&pool->mutex);
  pool->counts.ends[end]++;
  pthread_mutex_unlock(&pool->mutex);
}

/* Frames are written whole, so the socket blocks, but not for ever; they are read as they come. */
static bool set_blocking(int fd, bool blocking) {
  int flags = fcntl(fd, F_GETFL);
  return flags >= 0 && fcntl(fd, F_SETFL, blocking ? flags & ~O_NONBLOCK : flags | O_NONBLOCK) == 0;
}

static bool write_frames(struct runner *runner, char type, const void *bytes, size_t size) {
  int fd = runner->process.socket_fd;
  bool written = set_blocking(fd, true);
  for (size_t at = 0; written && (at < size || (size == 0 && at == 0));) {
    size_t piece = size - at < LOD_FRAME_MAX ? size - at : LOD_FRAME_MAX;
    written = lod_frame_write(fd, type, (const char *)bytes + at, piece) == LOD_OK;
    at += piece;
    if (size == 0)
      break;
  }
  return set_blocking(fd, false) && written;
}

/* A worker writes nothing, but its jail wants a folder: one that is removed as soon as it is open. In a container with a read-only root
 * there is no /tmp, and on a full disk or in a read-only store there may be no other. */
static int private_folder(const char *folder) {
  char path[PATH_MAX];
  int length = snprintf(path, sizeof path, "%s/refine-XXXXXX", folder != NULL ? folder : "/tmp");
  if (length < 0 || (size_t)length >= sizeof path || mkdtemp(path) == NULL)
    return folder != NULL ? private_folder(NULL) : -1;
  int fd = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  rmdir(path);
  return fd;
}

static enum lod_status start_worker(struct runner *runner, struct lod_problem *problem) {
  struct lod_pool *pool = runner->pool;
  int folder = private_folder(pool->folder), input = open("/dev/null", O_RDONLY | O_CLOEXEC);
  struct lod_spawn_settings settings = {.path = pool->worker_path,
                                        .input_fd = input,
                                        .output_fd = folder,
                                        .memory_limit_bytes = pool->settings.memory_limit_bytes,
                                        .cpu_limit_seconds = CPU_SECONDS,
                                        .niceness = LOD_NICE_ANSWER};
  enum lod_status status = folder < 0 || input < 0
                               ? lod_fail(problem, LOD_IO, "worker-missing", "A worker's folder cannot be made: %s.", strerror(errno))
                               : lod_process_spawn(&settings, &runner->process, problem);
  if (folder >= 0)
    close(folder);
  if (input >= 0)
    close(input);
  if (status != LOD_OK)
    return status;
  runner->alive = true;
  runner->born = monotonic();
  runner->reader = (struct lod_frame_reader){0};
  double seconds = pool->settings.deadline_seconds;
  struct timeval limit = {(time_t)seconds, (suseconds_t)(1e6 * (seconds - floor(seconds)))};
  setsockopt(runner->process.socket_fd, SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit);
  char job[96];
  snprintf(job, sizeof job, "{\"job\":\"refine\",\"memory_bytes\":%llu}", (unsigned long long)(pool->settings.memory_limit_bytes / 8 * 7));
  pthread_mutex_lock(&pool->mutex);
  pool->counts.workers_started++;
  pool->counts.alive++;
  pthread_mutex_unlock(&pool->mutex);
  if (write_frames(runner, 'J', job, strlen(job)))
    return LOD_OK;
  end_worker(runner);
  return lod_fail(problem, LOD_IO, "worker-crashed", "A worker ended as soon as it was started.");
}

/* ---- one request ---- */

struct talk {
  struct runner *runner;
  struct lod_pool_job *job;
  size_t room; /* of job->bytes, announced by 'R' */
  bool answered, told_to_stop, over;
  double deadline;
};

static void fail_job(struct lod_pool_job *job, enum lod_status status, const char *type, const char *detail) {
  free(job->facts);
  free(job->bytes);
  job->facts = NULL;
  job->bytes = NULL;
  job->size = 0;
  job->problem = (struct lod_problem){0};
  (void)lod_fail(&job->problem, status, type, "%s", detail);
}

static void crash(struct talk *talk, bool nonsense) {
  struct runner *runner = talk->runner;
  const char *what = nonsense ? "talked nonsense" : "died";
  char detail[200];
  struct lod_process_end end = end_worker(runner);
  if (end.signal != 0)
    snprintf(detail, sizeof detail, "The worker that refined this %s (signal %d); another takes its place.", what, end.signal);
  else
    snprintf(detail, sizeof detail, "The worker that refined this %s; another takes its place.", what);
  fail_job(talk->job, LOD_IO, "worker-crashed", detail);
  say(runner->pool, "refine: %s", detail);
  talk->over = true;
  count_worker(runner->pool, nonsense ? LOD_POOL_END_NONSENSE : end.signal != 0 ? LOD_POOL_END_SIGNAL : LOD_POOL_END_EXIT);
}

static bool ask(struct runner *runner, const struct lod_pool_job *job) {
  json_t *parameters = json_loads(job->parameters, 0, NULL);
  json_t *root = json_pack("{sssssIsIsIso}", "kind", job->kind, "base", job->base, "base_bytes", (json_int_t)job->base_size, "values_bytes",
                           (json_int_t)job->values_size, "max_triangles", (json_int_t)job->max_triangles, "parameters",
                           parameters != NULL ? parameters : json_object());
  char *text = root == NULL ? NULL : json_dumps(root, JSON_COMPACT);
  json_decref(root);
  bool asked = text != NULL && write_frames(runner, 'Q', text, strlen(text));
  free(text);
  return asked && (job->values_size == 0 || write_frames(runner, 'V', job->values, job->values_size));
}

static void take_failure(struct talk *talk, const struct lod_frame_reader *reader) {
  static const enum lod_status kStatuses[] = {LOD_BAD_INPUT, LOD_UNSUPPORTED, LOD_LIMIT, LOD_MEMORY, LOD_IO, LOD_CANCELLED};
  json_t *json = json_loadb(reader->payload, reader->payload_size, 0, NULL);
  const char *status = json_string_value(json_object_get(json, "status")), *type = json_string_value(json_object_get(json, "type"));
  const char *detail = json_string_value(json_object_get(json, "detail"));
  const char *parameter = json_string_value(json_object_get(json, "parameter"));
  enum lod_status found = LOD_IO;
  for (size_t i = 0; status != NULL && i < sizeof kStatuses / sizeof *kStatuses; i++)
    if (strcmp(lod_status_name(kStatuses[i]), status) == 0)
      found = kStatuses[i];
  fail_job(talk->job, found, type != NULL ? type : "failed", detail != NULL ? detail : "The refinement failed.");
  if (parameter != NULL)
    snprintf(talk->job->parameter, sizeof talk->job->parameter, "%s", parameter);
  json_decref(json);
  talk->over = true;
}

static bool take_facts(struct talk *talk, const struct lod_frame_reader *reader) {
  struct lod_pool_job *job = talk->job;
  json_t *json = json_loadb(reader->payload, reader->payload_size, JSON_REJECT_DUPLICATES, NULL);
  json_t *bytes = json_object_get(json, "bytes");
  bool good = !talk->answered && json_is_integer(bytes) && json_integer_value(bytes) >= 0 && json_integer_value(bytes) <= ANSWER_MAX_BYTES;
  if (good) {
    talk->room = (size_t)json_integer_value(bytes);
    talk->answered = true;
    job->facts = json_dumps(json, JSON_COMPACT);
    job->bytes = malloc(talk->room + 1);
    good = job->facts != NULL && job->bytes != NULL;
    talk->over = good && talk->room == 0;
  }
  json_decref(json);
  return good;
}

static bool take_bytes(struct talk *talk, const struct lod_frame_reader *reader) {
  struct lod_pool_job *job = talk->job;
  if (!talk->answered || reader->payload_size > talk->room - job->size)
    return false;
  memcpy(job->bytes + job->size, reader->payload, reader->payload_size);
  job->size += reader->payload_size;
  talk->over = job->size == talk->room;
  return true;
}

static void take_frames(struct talk *talk) {
  struct runner *runner = talk->runner;
  char type;
  do {
    enum lod_status status = lod_frame_read(runner->process.socket_fd, &runner->reader, &type);
    if (status != LOD_OK) {
      crash(talk, status == LOD_BAD_INPUT);
      return;
    }
    bool good = true;
    if (type == 'N')
      good = write_frames(runner, 'B', talk->job->base_bytes, talk->job->base_size);
    else if (type == 'R')
      good = take_facts(talk, &runner->reader);
    else if (type == 'G')
      good = take_bytes(talk, &runner->reader);
    else if (type == 'F')
      take_failure(talk, &runner->reader);
    else
      good = type == 0;
    if (!good)
      crash(talk, true);
  } while (!talk->over && type != 0 && monotonic() < talk->deadline);
}

static void check_wishes(struct talk *talk) {
  struct lod_pool *pool = talk->runner->pool;
  uint64_t count;
  ssize_t ignored = read(talk->runner->wake_fd, &count, sizeof count);
  (void)ignored;
  pthread_mutex_lock(&pool->mutex);
  bool stop = talk->job->cancelled || pool->stopping;
  pthread_mutex_unlock(&pool->mutex);
  if (!stop || talk->told_to_stop)
    return;
  talk->told_to_stop = true;
  talk->deadline = fmin(talk->deadline, monotonic() + kStopSeconds);
  if (!write_frames(talk->runner, 'X', "", 0))
    talk->deadline = 0;
}

static void time_out(struct talk *talk) {
  end_worker(talk->runner);
  count_worker(talk->runner->pool, talk->told_to_stop ? LOD_POOL_END_CANCELLED : LOD_POOL_END_DEADLINE);
  if (talk->told_to_stop)
    fail_job(talk->job, LOD_CANCELLED, "cancelled", "The request was cancelled.");
  else
    fail_job(talk->job, LOD_CANCELLED, "deadline", "The refinement took longer than this server allows; ask for fewer triangles.");
  talk->over = true;
}

static void talk_until_over(struct talk *talk) {
  struct runner *runner = talk->runner;
  while (!talk->over) {
    double left = talk->deadline - monotonic();
    if (left <= 0) {
      time_out(talk);
      return;
    }
    struct pollfd fds[3] = {{runner->process.socket_fd, POLLIN, 0}, {runner->wake_fd, POLLIN, 0}, {runner->process.log_fd, POLLIN, 0}};
    poll(fds, 3, (int)fmin(1000, ceil(1e3 * left)));
    if (fds[1].revents != 0)
      check_wishes(talk);
    if (fds[2].revents & POLLIN)
      drain_log(runner);
    if (fds[0].revents != 0)
      take_frames(talk);
  }
}

static void serve(struct runner *runner, struct lod_pool_job *job) {
  struct talk talk = {.runner = runner, .job = job, .deadline = job->deadline};
  struct lod_problem problem = {0};
  if (monotonic() >= job->deadline) {
    fail_job(job, LOD_CANCELLED, "deadline", "No worker was free in time.");
    return;
  }
  if (runner->alive && lod_process_has_ended(&runner->process)) { /* between two requests: nobody's fault */
    end_worker(runner);
    count_worker(runner->pool, LOD_POOL_END_IDLE);
  }
  bool fresh = !runner->alive;
  if (fresh && start_worker(runner, &problem) != LOD_OK) {
    job->problem = problem;
    return;
  }
  if (!ask(runner, job)) {
    end_worker(runner);
    count_worker(runner->pool, LOD_POOL_END_IDLE);
    if (fresh || start_worker(runner, &problem) != LOD_OK || !ask(runner, job)) {
      end_worker(runner);
      fail_job(job, LOD_IO, "worker-crashed", "The worker that should refine this died; another takes its place.");
      return;
    }
  }
  talk_until_over(&talk);
  if (job->problem.status != LOD_OK || job->cancelled) {
    enum lod_status status = job->problem.status;
    if (status == LOD_OK)
      fail_job(job, LOD_CANCELLED, "cancelled", "The request was cancelled.");
  }
}

/* ---- the queue ---- */

static void count_end(struct lod_pool *pool, const struct lod_pool_job *job) {
  if (job->problem.status == LOD_OK)
    pool->counts.answered++;
  else if (job->problem.status == LOD_CANCELLED && strcmp(job->problem.type, "deadline") == 0)
    pool->counts.late++;
  else if (job->problem.status == LOD_CANCELLED)
    pool->counts.cancelled++;
  else if (strcmp(job->problem.type, "worker-crashed") == 0)
    pool->counts.crashed++;
  else
    pool->counts.failed++;
}

/* The next job, or NULL when the pool stops. */
static struct lod_pool_job *next_job(struct runner *runner) {
  struct lod_pool *pool = runner->pool;
  pthread_mutex_lock(&pool->mutex);
  while (pool->first == NULL && !pool->stopping)
    pthread_cond_wait(&pool->queued, &pool->mutex);
  struct lod_pool_job *job = pool->stopping ? NULL : pool->first;
  if (job != NULL) {
    pool->first = job->next;
    if (pool->first == NULL)
      pool->last = &pool->first;
    pool->counts.waiting--;
    pool->counts.running++;
    pool->counts.wait_seconds += monotonic() - job->submitted;
    job->running = true;
    runner->job = job;
  }
  pthread_mutex_unlock(&pool->mutex);
  return job;
}

static void *run(void *argument) {
  struct runner *runner = argument;
  struct lod_pool *pool = runner->pool;
  struct lod_problem problem = {0};
  if (start_worker(runner, &problem) != LOD_OK)
    say(pool, "refine: %s", problem.detail);
  struct lod_pool_job *job;
  while ((job = next_job(runner)) != NULL) {
    double begun = monotonic();
    serve(runner, job);
    pthread_mutex_lock(&pool->mutex);
    runner->job = NULL;
    pool->counts.running--;
    pool->counts.seconds += monotonic() - begun;
    count_end(pool, job);
    pthread_mutex_unlock(&pool->mutex);
    job->done(job);
    if (!runner->alive && monotonic() - runner->born > kRestartSeconds) { /* so that the next request finds it warm */
      problem = (struct lod_problem){0};
      if (start_worker(runner, &problem) != LOD_OK)
        say(pool, "refine: %s", problem.detail);
    }
  }
  end_worker(runner);
  return NULL;
}

enum lod_status lod_pool_submit(struct lod_pool *pool, struct lod_pool_job *job, struct lod_problem *problem) {
  job->next = NULL;
  job->cancelled = job->running = false;
  job->facts = NULL;
  job->bytes = NULL;
  job->size = 0;
  job->parameter[0] = 0;
  job->problem = (struct lod_problem){0};
  job->submitted = monotonic();
  job->deadline = job->submitted + pool->settings.deadline_seconds;
  pthread_mutex_lock(&pool->mutex);
  /* A job that a free worker takes at once does not wait. */
  uint64_t free_workers = pool->runner_count - pool->counts.running;
  bool full = pool->stopping || pool->counts.waiting >= pool->settings.queue_limit + free_workers;
  if (full) {
    pool->counts.refused++;
  } else {
    *pool->last = job;
    pool->last = &job->next;
    pool->counts.waiting++;
    pthread_cond_signal(&pool->queued);
  }
  pthread_mutex_unlock(&pool->mutex);
  return full ? lod_fail(problem, LOD_LIMIT, "queue-full", "All workers are busy and too many requests wait already; try again later.")
              : LOD_OK;
}

void lod_pool_cancel(struct lod_pool *pool, struct lod_pool_job *job) {
  bool waited = false;
  pthread_mutex_lock(&pool->mutex);
  job->cancelled = true;
  if (!job->running)
    for (struct lod_pool_job **at = &pool->first; *at != NULL; at = &(*at)->next)
      if (*at == job) {
        *at = job->next;
        if (pool->last == &job->next)
          pool->last = at;
        pool->counts.waiting--;
        pool->counts.cancelled++;
        waited = true;
        break;
      }
  for (uint32_t i = 0; i < pool->runner_count; i++)
    if (pool->runners[i].job == job) {
      uint64_t one = 1;
      ssize_t ignored = write(pool->runners[i].wake_fd, &one, sizeof one);
      (void)ignored;
    }
  pthread_mutex_unlock(&pool->mutex);
  if (waited) {
    fail_job(job, LOD_CANCELLED, "cancelled", "The request was cancelled.");
    job->done(job);
  }
}

struct lod_pool_counts lod_pool_counts(struct lod_pool *pool) {
  pthread_mutex_lock(&pool->mutex);
  struct lod_pool_counts counts = pool->counts;
  pthread_mutex_unlock(&pool->mutex);
  return counts;
}

/* ---- birth and end ---- */

enum lod_status lod_pool_create(const struct lod_pool_settings *settings, struct lod_pool **result, struct lod_problem *problem) {
  struct lod_pool *pool = calloc(1, sizeof *pool);
  *result = NULL;
  if (pool == NULL || (pool->worker_path = strdup(settings->worker_path)) == NULL ||
      (settings->folder != NULL && (pool->folder = strdup(settings->folder)) == NULL)) {
    if (pool != NULL)
      free(pool->worker_path);
    free(pool);
    return lod_fail_memory(problem);
  }
  pool->settings = *settings;
  pool->last = &pool->first;
  pthread_mutex_init(&pool->mutex, NULL);
  pthread_cond_init(&pool->queued, NULL);
  pool->runner_count = settings->workers < 1 ? 1 : settings->workers > MAX_WORKERS ? MAX_WORKERS : settings->workers;
  for (uint32_t i = 0; i < pool->runner_count; i++) {
    pool->runners[i].pool = pool;
    pool->runners[i].wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
  }
  for (uint32_t i = 0; i < pool->runner_count; i++) {
    struct runner *runner = &pool->runners[i];
    runner->started = runner->wake_fd >= 0 && pthread_create(&runner->thread, NULL, run, runner) == 0;
    if (!runner->started) {
      lod_pool_destroy(pool);
      return lod_fail(problem, LOD_MEMORY, "cannot-start", "A thread for refinements could not be started.");
    }
  }
  *result = pool;
  return LOD_OK;
}

void lod_pool_destroy(struct lod_pool *pool) {
  if (pool == NULL)
    return;
  pthread_mutex_lock(&pool->mutex);
  pool->stopping = true;
  struct lod_pool_job *waiting = pool->first;
  pool->first = NULL;
  pool->last = &pool->first;
  pthread_cond_broadcast(&pool->queued);
  pthread_mutex_unlock(&pool->mutex);
  for (struct lod_pool_job *next; waiting != NULL; waiting = next) {
    next = waiting->next;
    fail_job(waiting, LOD_CANCELLED, "cancelled", "The server is stopping.");
    waiting->done(waiting);
  }
  for (uint32_t i = 0; i < pool->runner_count; i++) {
    uint64_t one = 1;
    ssize_t ignored = pool->runners[i].wake_fd < 0 ? 0 : write(pool->runners[i].wake_fd, &one, sizeof one);
    (void)ignored;
  }
  for (uint32_t i = 0; i < pool->runner_count; i++) {
    if (pool->runners[i].started)
      pthread_join(pool->runners[i].thread, NULL);
    if (pool->runners[i].wake_fd >= 0)
      close(pool->runners[i].wake_fd);
  }
  pthread_cond_destroy(&pool->queued);
  pthread_mutex_destroy(&pool->mutex);
  free(pool->worker_path);
  free(pool->folder);
  free(pool);
}

/* The queue with workers that succeed, crash, hang, flood, lie and eat memory. This program is its own worker (fake_worker.h). */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <dirent.h>
#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <sys/wait.h>

#include "server/jobs/jobs.h"
#include "server/store/files.h"
#include "tests/unit/server/jobs/fake_worker.h"

static char self[4096];

struct fixture {
  char root[64], path[80];
  struct lod_store *store;
  struct lod_jobs *jobs;
  struct lod_jobs_settings settings;
  atomic_uint changes;
  char log[65536];
  pthread_mutex_t log_mutex;
  size_t descriptors; /* before the store was opened */
};

static size_t count_entries(const char *path) {
  size_t count = 0;
  DIR *list = opendir(path);
  if (list == NULL)
    return 0;
  for (const struct dirent *file; (file = readdir(list)) != NULL;)
    count += strcmp(file->d_name, ".") != 0 && strcmp(file->d_name, "..") != 0;
  closedir(list);
  return count;
}

static void note_change(void *context, uint64_t job) {
  struct fixture *fixture = context;
  (void)job;
  atomic_fetch_add(&fixture->changes, 1);
}

static void note_log(void *context, const char *line) {
  struct fixture *fixture = context;
  pthread_mutex_lock(&fixture->log_mutex);
  strncat(fixture->log, line, sizeof fixture->log - strlen(fixture->log) - 1);
  pthread_mutex_unlock(&fixture->log_mutex);
}

static void start(struct fixture *fixture) {
  struct lod_problem problem = {0};
  if (lod_store_open(fixture->path, &fixture->store, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  fixture->settings.store = fixture->store;
  if (lod_jobs_create(&fixture->settings, &fixture->jobs, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
}

static void stop(struct fixture *fixture) {
  lod_jobs_destroy(fixture->jobs);
  lod_store_close(fixture->store);
  fixture->jobs = NULL;
  fixture->store = NULL;
}

static int set_up(void **state) {
  struct fixture *fixture = calloc(1, sizeof *fixture);
  strcpy(fixture->root, "/tmp/lodestream-jobs-XXXXXX");
  assert_non_null(mkdtemp(fixture->root));
  snprintf(fixture->path, sizeof fixture->path, "%s/store", fixture->root);
  pthread_mutex_init(&fixture->log_mutex, NULL);
  fixture->descriptors = count_entries("/proc/self/fd");
  fixture->settings = lod_jobs_defaults();
  fixture->settings.worker_path = self;
  fixture->settings.deadline_seconds = 20;
  fixture->settings.memory_limit_bytes = 64 << 20;
  fixture->settings.changed = note_change;
  fixture->settings.log = note_log;
  fixture->settings.context = fixture;
  start(fixture);
  *state = fixture;
  return 0;
}

static int tear_down(void **state) {
  struct fixture *fixture = *state;
  stop(fixture);
  char path[160];
  snprintf(path, sizeof path, "%s/work", fixture->path);
  assert_int_equal(count_entries(path), 0);                               /* no folder is left */
  assert_int_equal(count_entries("/proc/self/fd"), fixture->descriptors); /* no descriptor is left */
  assert_true(waitpid(-1, NULL, WNOHANG) < 0 && errno == ECHILD);         /* no zombie is left */
  lod_remove_tree(AT_FDCWD, fixture->root);
  pthread_mutex_destroy(&fixture->log_mutex);
  free(fixture);
  return 0;
}

static uint64_t submit(struct fixture *fixture, const char *id, const char *text) {
  int fd;
  uint64_t job;
  struct lod_problem problem = {0};
  assert_int_equal(lod_jobs_upload_create(fixture->jobs, &fd, NULL), LOD_OK);
  assert_int_equal(write(fd, text, strlen(text)), strlen(text));
  if (lod_jobs_submit(fixture->jobs, id, "bunny.ply", NULL, fd, &job, &problem) != LOD_OK)
    fail_msg("%s: %s", problem.type, problem.detail);
  return job;
}

/* slow: or until its worker has reported the stage "slow". */
static struct lod_job wait_for(struct fixture *fixture, uint64_t number, bool slow) {
  struct lod_job job = {0};
  for (int i = 0; i < 6000; i++) {
    assert_true(lod_jobs_find(fixture->jobs, number, &job));
    if (job.state == LOD_JOB_DONE || job.state == LOD_JOB_FAILED || (slow && strcmp(job.stage, "slow") == 0))
      return job;
    nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
  }
  fail_msg("job %lu does not end", (unsigned long)number);
  return job;
}

static struct lod_job run(struct fixture *fixture, const char *text) {
  return wait_for(fixture, submit(fixture, "bunny", text), false);
}

static void expect_failure(struct fixture *fixture, const char *text, enum lod_status status, const char *type, const char *detail) {
  struct lod_job job = run(fixture, text);
  if (job.state != LOD_JOB_FAILED || job.problem.status != status || strcmp(job.problem.type, type) != 0 ||
      strstr(job.problem.detail, detail) == NULL)
    fail_msg("\"%.40s\": state %d, %s, %s: %s", text, job.state, lod_status_name(job.problem.status), job.problem.type, job.problem.detail);
}

static void expect_model(struct fixture *fixture, const char *id, const char *revision) {
  struct lod_stored_model *model = lod_store_model_open(fixture->store, id);
  assert_non_null(model);
  assert_string_equal(model->revision, revision);
  lod_store_model_release(model);
}

/* ---- one job ---- */

static void a_bake_that_succeeds_is_in_the_store(void **state) {
  struct fixture *fixture = *state;
  uint64_t number = submit(fixture, "bunny", "succeed r7");
  struct lod_job job = wait_for(fixture, number, false);
  assert_int_equal(job.state, LOD_JOB_DONE);
  assert_int_equal(job.number, number);
  assert_string_equal(job.id, "bunny");
  assert_true(job.progress == 1);
  assert_true(job.finished >= job.created && job.created > 1e9);
  expect_model(fixture, "bunny", "r7");
  struct lod_jobs_counts counts = lod_jobs_counts(fixture->jobs);
  assert_int_equal(counts.done, 1);
  assert_int_equal(counts.failed + counts.queued + counts.running + counts.workers_crashed, 0);
  assert_true(counts.bake_seconds > 0);
  char path[160];
  snprintf(path, sizeof path, "%s/uploads", fixture->path);
  assert_int_equal(count_entries(path), 0);
  assert_false(lod_jobs_find(fixture->jobs, number + 1, &job));
  stop(fixture);                                    /* the last event may follow the state that wait_for saw */
  assert_true(atomic_load(&fixture->changes) >= 4); /* queued, running, storing, done at least */
  start(fixture);
}

static void the_worker_gets_its_descriptors_limits_and_nothing_else(void **state) {
  struct fixture *fixture = *state;
  setenv("TEST_SECRET", "token", 1);
  sigset_t set, old;
  sigemptyset(&set);
  sigaddset(&set, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &set, &old);
  signal(SIGPIPE, SIG_IGN);
  int leaky = fcntl(0, F_DUPFD, 200); /* inheritable, as a careless library would leave it */
  stop(fixture);
  start(fixture); /* threads that inherit the mask */
  struct lod_job job = run(fixture, "look-around");
  close(leaky);
  signal(SIGPIPE, SIG_DFL);
  pthread_sigmask(SIG_SETMASK, &old, NULL);
  unsetenv("TEST_SECRET");
  if (job.state != LOD_JOB_DONE)
    fail_msg("%s", job.problem.detail);
}

static void a_worker_that_dies_fails_its_job_with_the_reason_and_nothing_else(void **state) {
  struct fixture *fixture = *state;
  char text[32];
  snprintf(text, sizeof text, "signal %d", SIGSEGV);
  expect_failure(fixture, text, LOD_IO, "worker-crashed", "SIGSEGV: a bad memory access");
  assert_non_null(strstr(fixture->log, "last words?[31m of 11"));
  snprintf(text, sizeof text, "signal %d", SIGKILL);
  expect_failure(fixture, text, LOD_MEMORY, "worker-crashed", "memory runs out");
  snprintf(text, sizeof text, "signal %d", SIGSYS);
  expect_failure(fixture, text, LOD_IO, "worker-crashed", "jail forbids");
  snprintf(text, sizeof text, "signal %d", SIGXCPU);
  expect_failure(fixture, text, LOD_LIMIT, "limit-seconds", "processor time");
  snprintf(text, sizeof text, "signal %d", SIGUSR1);
  expect_failure(fixture, text, LOD_IO, "worker-crashed", "USR1");
  expect_failure(fixture, "exit 3", LOD_IO, "worker-crashed", "status 3 without an answer");
  expect_failure(fixture, "exit 0", LOD_IO, "worker-crashed", "status 0 without an answer");
  expect_failure(fixture, "close", LOD_IO, "worker-protocol", "closed its connection");
  struct lod_jobs_counts counts = lod_jobs_counts(fixture->jobs);
  assert_int_equal(counts.failed, 8);
  assert_int_equal(counts.workers_crashed, 7);
  assert_int_equal(counts.workers_killed, 1);
  assert_int_equal(run(fixture, "succeed r1").state, LOD_JOB_DONE);
}

static void a_worker_that_says_why_is_believed_in_words_only(void **state) {
  struct fixture *fixture = *state;
  expect_failure(fixture, "fail", LOD_BAD_INPUT, "truncated", "The file ends in the middle.");
  static const char *const kNonsense[] = {
      "say F{}",
      "say F{\"status\":\"ok\",\"type\":\"a\",\"detail\":\"b\"}",
      "say F{\"status\":\"io\",\"type\":\"A b\",\"detail\":\"b\"}",
      "say P{\"stage\":\"x\"}",
      "say P{\"stage\":\"x\",\"progress\":2}",
      "say P[]",
      "say Pnot json",
      "say J{}",
      "say X{}",
      "raw ABCDEFGHIJ", /* a length far beyond the limit */
  };
  for (size_t i = 0; i < sizeof kNonsense / sizeof kNonsense[0]; i++)
    expect_failure(fixture, kNonsense[i], LOD_IO, "worker-protocol", "not a frame of the protocol");
}

static void a_worker_that_hangs_spins_or_floods_meets_its_deadline(void **state) {
  struct fixture *fixture = *state;
  stop(fixture);
  fixture->settings.deadline_seconds = 1;
  start(fixture);
  expect_failure(fixture, "hang", LOD_LIMIT, "limit-seconds", "longer than the limit of 1 seconds");
  expect_failure(fixture, "spin", LOD_LIMIT, "limit-seconds", "longer than the limit of 1 seconds");
  expect_failure(fixture, "flood P{\"stage\":\"x\",\"progress\":0.5}", LOD_LIMIT, "limit-seconds", "longer than the limit of 1 seconds");
  assert_true(atomic_load(&fixture->changes) < 100); /* a flood of progress does not become a flood of events */
  assert_int_equal(lod_jobs_counts(fixture->jobs).workers_killed, 3);
}

static void a_worker_that_eats_memory_is_stopped(void **state) {
  struct fixture *fixture = *state;
  if (SANITIZED)
    skip(); /* AddressSanitizer needs terabytes of address space */
  expect_failure(fixture, "eat-memory", LOD_MEMORY, "worker-crashed", "SIGABRT");
}

static void a_worker_that_fills_the_disk_is_stopped(void **state) {
  struct fixture *fixture = *state;
  expect_failure(fixture, "fill-disk 1", LOD_LIMIT, "limit-output", "larger file");
  expect_failure(fixture, "fill-disk 2", LOD_LIMIT, "limit-output", "wrote more than the limit of 67108864 bytes");
}

static void a_worker_that_lies_fails_and_the_old_revision_serves_on(void **state) {
  struct fixture *fixture = *state;
  assert_int_equal(run(fixture, "succeed r1").state, LOD_JOB_DONE);
  expect_failure(fixture, "lie", LOD_BAD_INPUT, "bad-object", "does not have the SHA-256");
  expect_failure(fixture, "nothing-but-done", LOD_BAD_INPUT, "bad-manifest", "no regular file");
  expect_model(fixture, "bunny", "r1");
}

static void after_its_answer_a_worker_may_crash_stay_or_shout(void **state) {
  struct fixture *fixture = *state;
  assert_int_equal(run(fixture, "succeed-and-crash").state, LOD_JOB_DONE);
  assert_int_equal(run(fixture, "succeed-and-stay").state, LOD_JOB_DONE);
  assert_int_equal(run(fixture, "log").state, LOD_JOB_DONE);
}

static void a_program_that_is_not_there_is_a_clear_problem(void **state) {
  struct fixture *fixture = *state;
  stop(fixture);
  fixture->settings.worker_path = "/nowhere/lodestream";
  start(fixture);
  expect_failure(fixture, "succeed r1", LOD_IO, "worker-missing", "/nowhere/lodestream");
}

/* ---- many jobs ---- */

static void a_full_queue_refuses_and_a_bad_submission_takes_its_descriptor(void **state) {
  struct fixture *fixture = *state;
  stop(fixture);
  fixture->settings.queue_limit = 2;
  fixture->settings.upload_limit_bytes = 20;
  start(fixture);
  uint64_t number;
  uint64_t first = submit(fixture, "a", "slowly r1");
  wait_for(fixture, first, true);
  submit(fixture, "b", "slowly r1");
  uint64_t last = submit(fixture, "c", "succeed r1");
  static const char *const kIds[] = {"d", "d", "../d"};
  static const char *const kTexts[] = {"succeed r1", "longer than twenty bytes", "succeed r1"};
  static const char *const kTypes[] = {"queue-full", "limit-bytes", "bad-id"};
  for (size_t i = 0; i < 3; i++) {
    int fd;
    struct lod_problem problem = {0};
    assert_int_equal(lod_jobs_upload_create(fixture->jobs, &fd, NULL), LOD_OK);
    assert_int_equal(write(fd, kTexts[i], strlen(kTexts[i])), strlen(kTexts[i]));
    assert_true(lod_jobs_submit(fixture->jobs, kIds[i], "d.ply", NULL, fd, &number, &problem) != LOD_OK);
    assert_string_equal(problem.type, kTypes[i]);
    assert_int_equal(fcntl(fd, F_GETFD), -1);
  }
  assert_int_equal(wait_for(fixture, last, false).state, LOD_JOB_DONE);
}

static void uploads_of_one_model_take_effect_in_their_order(void **state) {
  struct fixture *fixture = *state;
  stop(fixture);
  fixture->settings.workers = 3;
  start(fixture);
  uint64_t slow = submit(fixture, "bunny", "slowly r1");
  uint64_t quick = submit(fixture, "bunny", "succeed r2");
  uint64_t other = submit(fixture, "other", "succeed r1");
  assert_int_equal(wait_for(fixture, other, false).state, LOD_JOB_DONE);
  struct lod_job job, first;
  assert_true(lod_jobs_find(fixture->jobs, quick, &job));
  assert_true(lod_jobs_find(fixture->jobs, slow, &first));
  /* Though two workers are idle: */
  assert_true(job.state == LOD_JOB_QUEUED || first.state == LOD_JOB_DONE);
  assert_int_equal(wait_for(fixture, quick, false).state, LOD_JOB_DONE);
  assert_int_equal(wait_for(fixture, slow, false).state, LOD_JOB_DONE);
  expect_model(fixture, "bunny", "r2");
}

static void jobs_go_on_after_an_orderly_restart(void **state) {
  struct fixture *fixture = *state;
  uint64_t numbers[3];
  assert_int_equal(run(fixture, "exit 3").state, LOD_JOB_FAILED);
  for (size_t i = 0; i < 3; i++)
    numbers[i] = submit(fixture, i == 2 ? "other" : "bunny", "slowly r5");
  wait_for(fixture, numbers[0], true);
  stop(fixture);
  start(fixture);
  for (size_t i = 0; i < 3; i++)
    assert_int_equal(wait_for(fixture, numbers[i], false).state, LOD_JOB_DONE);
  expect_model(fixture, "bunny", "r5");
  struct lod_job job;
  assert_true(lod_jobs_find(fixture->jobs, numbers[0] - 1, &job)); /* and the one that failed is still known, with its reason */
  assert_string_equal(job.problem.type, "worker-crashed");
  assert_true(submit(fixture, "bunny", "succeed r6") > numbers[2]);
}

/* A daemon that is killed while the job `poison` runs. */
_Noreturn static void live_and_die(struct fixture *fixture, int out, bool first) {
  uint64_t numbers[3] = {1, 2, 3};
  start(fixture);
  if (first) {
    numbers[0] = submit(fixture, "poison", "hang"); /* stands for a bake that takes the daemon down */
    numbers[1] = submit(fixture, "bunny", "slowly r9");
    numbers[2] = submit(fixture, "bunny", "fail");
    if (write(out, numbers, sizeof numbers) != sizeof numbers)
      _exit(1);
  }
  struct lod_job job = {0};
  while (strcmp(job.stage, "start") != 0 && job.state != LOD_JOB_FAILED)
    if (!lod_jobs_find(fixture->jobs, numbers[0], &job))
      _exit(2);
  nanosleep(&(struct timespec){.tv_nsec = 150000000}, NULL);
  kill(getpid(), SIGKILL);
  _exit(3);
}

static void a_killed_daemon_runs_its_jobs_at_the_next_start_but_not_for_ever(void **state) {
  struct fixture *fixture = *state;
  uint64_t numbers[3];
  stop(fixture);
  for (int life = 0; life < 3; life++) {
    int fds[2], status;
    assert_int_equal(pipe2(fds, O_CLOEXEC), 0);
    pid_t child = fork();
    if (child == 0)
      live_and_die(fixture, fds[1], life == 0);
    if (life == 0)
      assert_int_equal(read(fds[0], numbers, sizeof numbers), sizeof numbers);
    close(fds[0]);
    close(fds[1]);
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFSIGNALED(status));
  }
  start(fixture);
  struct lod_job poison = wait_for(fixture, numbers[0], false);
  assert_int_equal(poison.state, LOD_JOB_FAILED);
  assert_string_equal(poison.problem.type, "gave-up");
  assert_int_equal(wait_for(fixture, numbers[1], false).state, LOD_JOB_DONE);
  assert_string_equal(wait_for(fixture, numbers[2], false).problem.type, "truncated");
  expect_model(fixture, "bunny", "r9");
}

static void a_delete_after_an_upload_wins(void **state) {
  struct fixture *fixture = *state;
  uint64_t running = submit(fixture, "bunny", "hang");
  uint64_t waiting = submit(fixture, "bunny", "succeed r1");
  uint64_t other = submit(fixture, "other", "succeed r1");
  bool existed;
  struct lod_job job = {0};
  while (job.state != LOD_JOB_RUNNING)
    assert_true(lod_jobs_find(fixture->jobs, running, &job));
  assert_int_equal(lod_jobs_delete_model(fixture->jobs, "bunny", &existed, NULL), LOD_OK);
  assert_true(existed); /* its uploads were there */
  assert_string_equal(wait_for(fixture, running, false).problem.type, "cancelled");
  assert_string_equal(wait_for(fixture, waiting, false).problem.type, "cancelled");
  assert_int_equal(wait_for(fixture, other, false).state, LOD_JOB_DONE);
  assert_null(lod_store_model_open(fixture->store, "bunny"));
  struct lod_jobs_counts counts = lod_jobs_counts(fixture->jobs);
  assert_int_equal(counts.queued + counts.running, 0);
  assert_int_equal(run(fixture, "succeed r2").state, LOD_JOB_DONE); /* and a later upload is not held back */
}

/* ---- later families ---- */

static void restart_with_later_families(struct fixture *fixture) {
  stop(fixture);
  fixture->settings.families = "cluster";
  fixture->settings.later_families = "cluster, envelope";
  fixture->settings.deadline_seconds = 600; /* those that hang do so until they are ended */
  start(fixture);
}

static void later_families_come_in_a_second_job_of_the_same_upload(void **state) {
  struct fixture *fixture = *state;
  restart_with_later_families(fixture);
  struct lod_job first = run(fixture, "families ");
  assert_int_equal(first.state, LOD_JOB_DONE);
  assert_true(first.next > first.number);
  struct lod_job second = wait_for(fixture, first.next, false);
  assert_int_equal(second.state, LOD_JOB_DONE);
  assert_int_equal(second.next, 0);
  expect_model(fixture, "bunny", "-cluster---envelope-");
  char path[160];
  snprintf(path, sizeof path, "%s/uploads", fixture->path);
  assert_int_equal(count_entries(path), 0);
}

static void later_families_that_the_first_bake_has_need_no_second(void **state) {
  struct fixture *fixture = *state;
  stop(fixture);
  fixture->settings.families = "envelope,cluster";
  fixture->settings.later_families = "cluster";
  start(fixture);
  struct lod_job job = run(fixture, "families ");
  assert_int_equal(job.state, LOD_JOB_DONE);
  assert_int_equal(job.next, 0);
  expect_model(fixture, "bunny", "-envelope---cluster-");
}

static void later_families_without_first_ones_are_refused(void **state) {
  struct fixture *fixture = *state;
  struct lod_jobs *jobs;
  struct lod_problem problem = {0};
  stop(fixture);
  assert_int_equal(lod_store_open(fixture->path, &fixture->store, NULL), LOD_OK);
  fixture->settings.later_families = "envelope";
  assert_int_equal(lod_jobs_create(&fixture->settings, &jobs, &problem), LOD_BAD_INPUT);
  assert_non_null(strstr(problem.detail, "later-families"));
  lod_store_close(fixture->store);
  fixture->settings.later_families = NULL;
  start(fixture);
}

static void a_second_job_that_fails_leaves_the_first_ones_levels(void **state) {
  struct fixture *fixture = *state;
  restart_with_later_families(fixture);
  struct lod_job first = run(fixture, "families late-fail");
  assert_int_equal(first.state, LOD_JOB_DONE);
  assert_string_equal(wait_for(fixture, first.next, false).problem.type, "truncated");
  expect_model(fixture, "bunny", "-cluster-");
}

static void models_that_are_not_served_yet_come_before_later_families(void **state) {
  struct fixture *fixture = *state;
  restart_with_later_families(fixture);
  uint64_t slow = submit(fixture, "bunny", "slowly r1"); /* while it runs, others queue up */
  uint64_t second = submit(fixture, "second", "families late-hang");
  uint64_t third = submit(fixture, "third", "families late-hang");
  assert_int_equal(wait_for(fixture, slow, false).state, LOD_JOB_DONE);
  assert_int_equal(wait_for(fixture, second, false).state, LOD_JOB_DONE);
  assert_int_equal(wait_for(fixture, third, false).state, LOD_JOB_DONE); /* though the later job of `second`, which hangs, is older */
}

/* The later bake of `bunny` hangs until this program ends it: were there no room beside it, `second` would never begin. */
static void a_model_that_is_not_served_yet_does_not_wait_for_later_families_that_are_being_baked(void **state) {
  struct fixture *fixture = *state;
  restart_with_later_families(fixture);
  struct lod_job bunny = run(fixture, "families late-hang");
  wait_for(fixture, bunny.next, true);
  struct lod_jobs_counts counts = lod_jobs_counts(fixture->jobs);
  assert_int_equal(counts.running, 1);
  assert_int_equal(counts.running_later, 1);
  assert_int_equal(wait_for(fixture, submit(fixture, "second", "families late-hang"), false).state, LOD_JOB_DONE);
  struct lod_job third = wait_for(fixture, submit(fixture, "third", "families late-hang"), false);
  assert_int_equal(third.state, LOD_JOB_DONE);
  assert_int_equal(wait_for(fixture, bunny.next, true).state, LOD_JOB_RUNNING); /* and was not disturbed */
  /* The spare worker is for first bakes: later ones run one after another. */
  counts = lod_jobs_counts(fixture->jobs);
  assert_int_equal(counts.running_later, 1);
  assert_int_equal(counts.queued_later, 2);
  assert_true(counts.first_wait_seconds >= 0 && counts.later_wait_seconds >= 0);
  bool existed;
  assert_int_equal(lod_jobs_delete_model(fixture->jobs, "bunny", &existed, NULL), LOD_OK);
  assert_int_equal(lod_jobs_delete_model(fixture->jobs, "second", &existed, NULL), LOD_OK);
  assert_string_equal(wait_for(fixture, third.next, true).stage, "slow"); /* now it is its turn */
}

/* With nothing to add, the spare worker would be a second bake at once, which `workers` does not allow. */
static void first_bakes_are_no_more_at_once_than_workers(void **state) {
  struct fixture *fixture = *state;
  restart_with_later_families(fixture);
  uint64_t slow = submit(fixture, "bunny", "say P{\"stage\":\"slow\",\"progress\":0}");
  wait_for(fixture, slow, true);
  uint64_t second = submit(fixture, "second", "families ");
  struct lod_problem problem;
  assert_true(lod_jobs_ready(fixture->jobs, &problem)); /* starts a process: a free worker would have begun `second` meanwhile */
  struct lod_job job;
  assert_true(lod_jobs_find(fixture->jobs, second, &job));
  assert_int_equal(job.state, LOD_JOB_QUEUED);
  bool existed;
  assert_int_equal(lod_jobs_delete_model(fixture->jobs, "bunny", &existed, NULL), LOD_OK);
  assert_int_equal(wait_for(fixture, second, false).state, LOD_JOB_DONE);
}

static void a_second_job_that_nobody_wants_any_more_ends_at_the_start(void **state) {
  struct fixture *fixture = *state;
  restart_with_later_families(fixture);
  struct lod_job first = run(fixture, "families late-hang");
  wait_for(fixture, first.next, true);
  stop(fixture);
  fixture->settings.later_families = NULL;
  start(fixture);
  struct lod_job second = wait_for(fixture, first.next, false);
  assert_int_equal(second.state, LOD_JOB_FAILED);
  assert_string_equal(second.problem.type, "cancelled");
  expect_model(fixture, "bunny", "-cluster-");
}

static void a_new_upload_ends_the_second_job_of_the_one_before(void **state) {
  struct fixture *fixture = *state;
  restart_with_later_families(fixture);
  struct lod_job first = run(fixture, "families late-hang");
  wait_for(fixture, first.next, true);
  struct lod_job again = run(fixture, "families ");
  assert_int_equal(again.state, LOD_JOB_DONE);
  assert_string_equal(wait_for(fixture, first.next, false).problem.type, "superseded");
  assert_int_equal(wait_for(fixture, again.next, false).state, LOD_JOB_DONE);
  expect_model(fixture, "bunny", "-cluster---envelope-");
}

static void a_second_job_survives_a_restart(void **state) {
  struct fixture *fixture = *state;
  restart_with_later_families(fixture);
  struct lod_job first = run(fixture, "families late-hang");
  struct lod_job second = wait_for(fixture, first.next, true);
  assert_int_equal(second.state, LOD_JOB_RUNNING);
  stop(fixture);
  start(fixture);
  assert_int_equal(wait_for(fixture, first.next, true).state, LOD_JOB_RUNNING); /* asks for envelope again, so it hangs again */
  bool existed;
  assert_int_equal(lod_jobs_delete_model(fixture->jobs, "bunny", &existed, NULL), LOD_OK);
  assert_string_equal(wait_for(fixture, first.next, false).problem.type, "cancelled");
}

static void ready_means_that_a_worker_comes_up(void **state) {
  struct fixture *fixture = *state;
  struct lod_problem problem = {0};
  const char *good = fixture->settings.worker_path;
  assert_true(lod_jobs_ready(fixture->jobs, &problem));
  assert_int_equal(problem.status, LOD_OK);
  assert_int_equal(run(fixture, "succeed r1").state, LOD_JOB_DONE); /* a trial leaves nothing in the way */
  static const char *const kBad[][2] = {{"/bin/false", "worker-crashed"}, {"/nowhere/worker", "worker-missing"}};
  for (size_t i = 0; i < sizeof kBad / sizeof *kBad; i++) {
    stop(fixture);
    fixture->settings.worker_path = kBad[i][0];
    start(fixture);
    assert_false(lod_jobs_ready(fixture->jobs, &problem));
    assert_string_equal(problem.type, kBad[i][1]);
  }
  stop(fixture);
  fixture->settings.worker_path = good;
  start(fixture);
}

static void only_the_last_ended_jobs_are_kept(void **state) {
  struct fixture *fixture = *state;
  struct lod_job job;
  stop(fixture);
  fixture->settings.kept_jobs = 3;
  start(fixture);
  for (uint64_t number = 1; number <= 5; number++)
    assert_int_equal(wait_for(fixture, submit(fixture, "bunny", "fail"), false).number, number);
  for (int round = 0; round < 2; round++) {
    stop(fixture);
    start(fixture);
    for (uint64_t number = 1; number <= 6; number++)
      assert_int_equal(lod_jobs_find(fixture->jobs, number, &job), number >= 3 && number <= 5);
  }
  assert_true(lod_jobs_find(fixture->jobs, 4, &job));
  assert_string_equal(job.problem.type, "truncated");
  assert_int_equal(submit(fixture, "bunny", "succeed r1"), 6);
}

int main(int argc, char **argv) {
  if (argc > 1 && strcmp(argv[1], "worker") == 0)
    return act_as_worker();
  ssize_t size = readlink("/proc/self/exe", self, sizeof self - 1);
  if (size < 0)
    return 1;
  const struct CMUnitTest tests[] = {
#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)
      TEST(a_bake_that_succeeds_is_in_the_store),
      TEST(the_worker_gets_its_descriptors_limits_and_nothing_else),
      TEST(a_worker_that_dies_fails_its_job_with_the_reason_and_nothing_else),
      TEST(a_worker_that_says_why_is_believed_in_words_only),
      TEST(a_worker_that_hangs_spins_or_floods_meets_its_deadline),
      TEST(a_worker_that_eats_memory_is_stopped),
      TEST(a_worker_that_fills_the_disk_is_stopped),
      TEST(a_worker_that_lies_fails_and_the_old_revision_serves_on),
      TEST(after_its_answer_a_worker_may_crash_stay_or_shout),
      TEST(a_program_that_is_not_there_is_a_clear_problem),
      TEST(a_full_queue_refuses_and_a_bad_submission_takes_its_descriptor),
      TEST(uploads_of_one_model_take_effect_in_their_order),
      TEST(jobs_go_on_after_an_orderly_restart),
      TEST(a_killed_daemon_runs_its_jobs_at_the_next_start_but_not_for_ever),
      TEST(a_delete_after_an_upload_wins),
      TEST(later_families_come_in_a_second_job_of_the_same_upload),
      TEST(later_families_that_the_first_bake_has_need_no_second),
      TEST(later_families_without_first_ones_are_refused),
      TEST(a_second_job_that_fails_leaves_the_first_ones_levels),
      TEST(models_that_are_not_served_yet_come_before_later_families),
      TEST(a_model_that_is_not_served_yet_does_not_wait_for_later_families_that_are_being_baked),
      TEST(first_bakes_are_no_more_at_once_than_workers),
      TEST(a_second_job_that_nobody_wants_any_more_ends_at_the_start),
      TEST(a_new_upload_ends_the_second_job_of_the_one_before),
      TEST(a_second_job_survives_a_restart),
      TEST(ready_means_that_a_worker_comes_up),
      TEST(only_the_last_ended_jobs_are_kept),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}

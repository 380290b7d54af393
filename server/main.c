/* lodestreamd: store, jobs and HTTP in one process that parses no model. */
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include "server/config.h"
#include "server/http/deadline.h"
#include "server/http/errands.h"
#include "server/http/http.h"
#include "server/http/tls.h"
#include "server/jobs/pool.h"
#include "server/log.h"
#include "server/models_dir.h"
#include "server/notify.h"
#include "server/store/answers.h"
#include "server/store/check.h"

enum { EXIT_STOPPED = 0, EXIT_CANNOT_START = 1, EXIT_USAGE = 2 };

/* Settings that were in force; kept, because requests may still look at them. */
struct kept_config {
  struct lod_config config;
  struct kept_config *older;
};

struct daemon {
  struct lod_config config; /* of the start */
  struct kept_config *kept;
  char *limits_json;
  struct lod_metrics *metrics;
  struct lod_store *store;
  struct lod_jobs *jobs;
  struct lod_pool *pool;
  struct lod_errands *errands;
  struct lod_service service;
  struct lod_models_dir *models;
  pthread_mutex_t http_lock; /* job_changed, on a thread of jobs, must find no server that is being freed */
  struct lod_http *http;
};

static void job_changed(void *context, uint64_t job) {
  struct daemon *daemon = context;
  (void)job;
  atomic_fetch_add(&daemon->service.job_changes, 1);
  pthread_mutex_lock(&daemon->http_lock);
  if (daemon->http)
    lod_http_job_changed(daemon->http);
  pthread_mutex_unlock(&daemon->http_lock);
}

/* Every connection is a descriptor; Debian's soft limit is 1024. */
static void raise_descriptor_limit(void) {
  struct rlimit limit;
  if (getrlimit(RLIMIT_NOFILE, &limit) == 0) {
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_NOFILE, &limit);
  }
}

/* The queue tells of bakes that end badly and of what their workers said. */
static void log_line(void *context, const char *line) {
  (void)context;
  lod_log(LOD_LOG_WARN, "%s", line);
}

static enum lod_status start_jobs(struct daemon *daemon, struct lod_problem *problem) {
  const struct lod_config *config = &daemon->config;
  struct lod_jobs_settings settings = lod_jobs_defaults();
  daemon->limits_json = lod_config_limits_json(config);
  if (!daemon->limits_json)
    return lod_fail_memory(problem);
  settings.store = daemon->store;
  settings.worker_path = config->worker;
  settings.workers = (uint32_t)config->bakes;
  settings.threads = (uint32_t)config->bake_threads;
  settings.queue_limit = (uint32_t)config->bake_queue;
  settings.deadline_seconds = (uint32_t)config->bake_seconds;
  settings.memory_limit_bytes = config->bake_memory;
  settings.upload_limit_bytes = config->upload_bytes;
  settings.limits_json = daemon->limits_json;
  settings.families = config->families;
  settings.later_families = config->later_families;
  settings.envelope = config->envelope;
  settings.log = log_line;
  settings.changed = job_changed;
  settings.context = daemon;
  return lod_jobs_create(&settings, &daemon->jobs, problem);
}

static enum lod_status start_pool(struct daemon *daemon, struct lod_problem *problem) {
  const struct lod_config *config = &daemon->config;
  struct lod_pool_settings settings = lod_pool_defaults();
  settings.worker_path = config->worker;
  settings.workers = (uint32_t)config->refine_workers;
  settings.queue_limit = (uint32_t)config->refine_queue;
  settings.deadline_seconds = (double)config->refine_seconds;
  settings.memory_limit_bytes = config->refine_memory;
  settings.log = log_line;
  char folder[4096];
  int length = snprintf(folder, sizeof folder, "%s/work", config->store);
  settings.folder = length > 0 && (size_t)length < sizeof folder ? folder : NULL;
  LOD_TRY(lod_pool_create(&settings, &daemon->pool, problem));
  daemon->errands = lod_errands_create(daemon->pool);
  return daemon->errands ? LOD_OK : lod_fail_memory(problem);
}

static enum lod_status start(struct daemon *daemon, struct lod_problem *problem) {
  const struct lod_config *config = &daemon->config;
  uint32_t route_count;
  const char *const *routes = lod_route_names(&route_count);
  static const char *cuts[LOD_CUT_COUNT];
  for (int i = 0; i < LOD_CUT_COUNT; i++)
    cuts[i] = lod_cut_name((enum lod_cut)i);
  daemon->metrics = lod_metrics_create(routes, route_count, cuts, LOD_CUT_COUNT);
  if (!daemon->metrics)
    return lod_fail_memory(problem);
  lod_metrics_set(daemon->metrics, LOD_METRIC_START_TIME, (double)time(NULL));
  LOD_TRY(lod_store_open(config->store, &daemon->store, problem));
  lod_store_set_quota(daemon->store, config->store_bytes);
  lod_answers_set_limit(lod_store_answers(daemon->store), config->refined_bytes);
  LOD_TRY(start_jobs(daemon, problem));
  LOD_TRY(lod_service_init(&daemon->service, daemon->store, daemon->jobs, daemon->metrics, config, problem));
  if (config->refine_workers != 0)
    LOD_TRY(start_pool(daemon, problem));
  daemon->service.pool = daemon->pool;
  daemon->service.errands = daemon->errands;
  struct lod_http *http;
  LOD_TRY(lod_http_create(&daemon->service, lod_notify_take_listener(), &http, problem));
  pthread_mutex_lock(&daemon->http_lock);
  daemon->http = http;
  pthread_mutex_unlock(&daemon->http_lock);
  if (*config->models)
    LOD_TRY(lod_models_dir_create(config->models, daemon->store, daemon->jobs, &daemon->models, problem));
  return LOD_OK;
}

static void stop(struct daemon *daemon) {
  lod_models_dir_destroy(daemon->models);
  pthread_mutex_lock(&daemon->http_lock);
  struct lod_http *http = daemon->http;
  daemon->http = NULL;
  pthread_mutex_unlock(&daemon->http_lock);
  const struct lod_config *config = daemon->service.config ? daemon->service.config : &daemon->config;
  lod_http_destroy(http, http ? (double)config->drain_seconds : 0);
  lod_pool_destroy(daemon->pool);
  lod_errands_destroy(daemon->errands);
  lod_jobs_destroy(daemon->jobs);
  lod_service_finish(&daemon->service);
  lod_store_close(daemon->store);
  lod_metrics_destroy(daemon->metrics);
  free(daemon->limits_json);
  lod_config_finish(&daemon->config);
  while (daemon->kept) {
    struct kept_config *older = daemon->kept->older;
    lod_config_finish(&daemon->kept->config);
    free(daemon->kept);
    daemon->kept = older;
  }
}

/* ---- while it runs ---- */

/* All or nothing: with anything wrong in the new settings, the old ones stay. */
static enum lod_status reload_settings(struct daemon *daemon, int argc, char **argv, const char *program, struct lod_problem *problem) {
  struct kept_config *kept = calloc(1, sizeof *kept);
  enum lod_config_action action;
  enum lod_log_level level;
  char fixed[512];
  if (!kept)
    return lod_fail_memory(problem);
  kept->older = daemon->kept;
  daemon->kept = kept;
  LOD_TRY(lod_config_read(argc, argv, program, &kept->config, &action, problem));
  if (!lod_log_level_parse(kept->config.log_level, &level))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "log-level must be debug, info, warn, error or off, not '%s'.",
                    kept->config.log_level);
  lod_config_fixed_differences(&daemon->config, &kept->config, fixed, sizeof fixed);
  if (*fixed)
    lod_log(LOD_LOG_WARN, "reload: these settings take effect at the next start: %s", fixed);
  if (*kept->config.tls_cert && *daemon->config.tls_cert)
    LOD_TRY(lod_tls_load(kept->config.tls_cert, kept->config.tls_key, problem));
  LOD_TRY(lod_service_set_config(&daemon->service, &kept->config, problem));
  lod_http_settings_changed(daemon->http);
  lod_store_set_quota(daemon->store, kept->config.store_bytes);
  lod_answers_set_limit(lod_store_answers(daemon->store), kept->config.refined_bytes);
  lod_log_set_level(level);
  return LOD_OK;
}

static void reload(struct daemon *daemon, int argc, char **argv, const char *program) {
  struct lod_problem problem = {0};
  lod_notify_reloading();
  if (reload_settings(daemon, argc, argv, program, &problem) == LOD_OK)
    lod_log(LOD_LOG_INFO, "reload: the settings were read again");
  else
    lod_log(LOD_LOG_ERROR, "reload: the old settings stay: %s", problem.detail);
  lod_notify("READY=1");
}

/* Until SIGTERM or SIGINT. A manager's watchdog hears of us only while every event loop turns. */
static void run(struct daemon *daemon, const sigset_t *signals, int argc, char **argv, const char *program) {
  enum { HANGS_SECONDS = 10 };
  double every = lod_notify_watchdog_seconds() / 2;
  struct timespec wait = {.tv_sec = (time_t)every, .tv_nsec = (long)(1e9 * (every - (double)(time_t)every))};
  for (;;) {
    int number = every > 0 ? sigtimedwait(signals, NULL, &wait) : sigwaitinfo(signals, NULL);
    if (number == SIGHUP) {
      reload(daemon, argc, argv, program);
    } else if (number > 0) {
      const struct lod_config *config = daemon->service.config;
      lod_notify("STOPPING=1");
      lod_log(LOD_LOG_INFO, "%s: finishing what was begun, for at most %llu s", strsignal(number),
              (unsigned long long)config->drain_seconds);
      return;
    } else if (every > 0 && lod_http_idle_seconds(daemon->http) < HANGS_SECONDS) {
      lod_notify("WATCHDOG=1");
    }
  }
}

/* ---- what else the program does ---- */

static int check_store(const struct lod_config *config, bool repair) {
  struct lod_store_findings f;
  struct lod_problem problem = {0};
  if (lod_store_check(config->store, repair, stdout, &f, &problem) != LOD_OK) {
    fprintf(stderr, "lodestreamd: %s\n", problem.detail);
    return EXIT_CANNOT_START;
  }
  uint64_t found = f.damaged + f.missing + f.broken_models + f.stray + f.lost_uploads + f.refined_damaged + f.refined_stray;
  printf("%llu models, %llu objects, %llu bytes: %llu damaged, %llu missing, %llu models not whole, %llu stray files, %llu lost uploads; "
         "%llu refinements: %llu damaged, %llu stray",
         (unsigned long long)f.models, (unsigned long long)f.objects, (unsigned long long)f.bytes, (unsigned long long)f.damaged,
         (unsigned long long)f.missing, (unsigned long long)f.broken_models, (unsigned long long)f.stray,
         (unsigned long long)f.lost_uploads, (unsigned long long)f.refined, (unsigned long long)f.refined_damaged,
         (unsigned long long)f.refined_stray);
  printf(repair && found ? "; repaired\n" : "\n");
  return found && !repair ? EXIT_CANNOT_START : EXIT_STOPPED;
}

static int do_other(enum lod_config_action action, const struct lod_config *config) {
  switch (action) {
  case LOD_CONFIG_HELP:
    lod_config_help(stdout);
    return EXIT_STOPPED;
  case LOD_CONFIG_MAKE_TOKEN:
    return lod_token_make(config->token_name, stdout) ? EXIT_STOPPED : EXIT_CANNOT_START;
  case LOD_CONFIG_CHECK_STORE:
  case LOD_CONFIG_REPAIR_STORE:
    return check_store(config, action == LOD_CONFIG_REPAIR_STORE);
  default:
    printf("lodestreamd %s\n", LOD_VERSION);
    return EXIT_STOPPED;
  }
}

static void program_path(char *path, size_t size) {
  ssize_t length = readlink("/proc/self/exe", path, size - 1);
  path[length > 0 ? length : 0] = 0;
}

int main(int argc, char **argv) {
  static struct daemon daemon = {.http_lock = PTHREAD_MUTEX_INITIALIZER};
  struct lod_problem problem = {0};
  enum lod_config_action action;
  char program[4096];
  program_path(program, sizeof program);
  enum lod_status status = lod_config_read(argc, argv, program, &daemon.config, &action, &problem);
  enum lod_log_level level = LOD_LOG_INFO;
  if (status == LOD_OK && action == LOD_CONFIG_RUN && !lod_log_level_parse(daemon.config.log_level, &level))
    status = lod_fail(&problem, LOD_BAD_INPUT, "bad-flag", "--log-level must be debug, info, warn, error or off, not '%s'.",
                      daemon.config.log_level);
  if (status != LOD_OK) {
    fprintf(stderr, "lodestreamd: %s\n", problem.detail);
    lod_config_finish(&daemon.config);
    return EXIT_USAGE;
  }
  if (action != LOD_CONFIG_RUN) {
    int result = do_other(action, &daemon.config);
    lod_config_finish(&daemon.config);
    return result;
  }
  lod_log_open(strcmp(daemon.config.log, "json") == 0, level);
  signal(SIGPIPE, SIG_IGN);
  raise_descriptor_limit();
  /* Blocked before any thread starts, so that only sigwait below takes them. */
  sigset_t ends;
  sigemptyset(&ends);
  sigaddset(&ends, SIGTERM);
  sigaddset(&ends, SIGINT);
  sigaddset(&ends, SIGHUP);
  pthread_sigmask(SIG_BLOCK, &ends, NULL);

  int result = EXIT_STOPPED;
  if (start(&daemon, &problem) == LOD_OK) {
    printf("listening on %s\n", lod_http_url(daemon.http));
    fflush(stdout);
    if (!daemon.service.tokens)
      lod_log(LOD_LOG_WARN, "no --token-file: anyone who can connect may upload and delete models");
    lod_notify("READY=1");
    run(&daemon, &ends, argc, argv, program);
  } else {
    fprintf(stderr, "lodestreamd: %s\n", problem.detail);
    result = EXIT_CANNOT_START;
  }
  stop(&daemon);
  return result;
}

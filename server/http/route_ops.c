/* What operators ask: alive, ready, counted, described. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "server/http/errands.h"
#include "server/http/routes.h"
#include "server/store/answers.h"

static void answer_ok(struct lod_exchange *exchange) {
  struct lod_reply *reply = &exchange->reply;
  reply->status = 200;
  reply->cache = LOD_CACHE_NO_STORE;
  reply->type = "text/plain; charset=utf-8";
  reply->body = lod_body_create("ok\n", 3, NULL, NULL);
}

void lod_answer_healthz(struct lod_exchange *exchange) {
  answer_ok(exchange);
}

/* Touches the disk and may try a worker, so it runs in the background. */
static void check_ready(struct lod_exchange *exchange) {
  struct lod_problem problem = {0};
  const char *worker = exchange->service->config->worker;
  if (!lod_store_ready(exchange->service->store, &problem))
    lod_reply_problem(&exchange->reply, 503, *problem.type ? problem.type : "not-ready",
                      *problem.detail ? problem.detail : "The store is not ready.", "");
  else if (access(worker, X_OK) != 0)
    lod_reply_problem(&exchange->reply, 503, "no-worker", "The worker program cannot be run; see --worker.", "");
  else if (!lod_jobs_ready(exchange->service->jobs, &problem))
    lod_reply_problem(&exchange->reply, 503, problem.type, problem.detail, "");
  else
    answer_ok(exchange);
}

void lod_answer_readyz(struct lod_exchange *exchange) {
  if (atomic_load(&exchange->service->draining))
    lod_reply_problem(&exchange->reply, 503, "draining", "The server is about to stop.", "");
  else
    exchange->work = check_ready;
}

/* Seconds on a processor, bytes in memory and open descriptors of this process; 0 where /proc does not say. */
static void measure_process(double *cpu, double *resident, double *files) {
  struct timespec time;
  long pages = 0;
  *cpu = clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time) == 0 ? (double)time.tv_sec + 1e-9 * (double)time.tv_nsec : 0;
  FILE *file = fopen("/proc/self/statm", "re");
  if (!file || fscanf(file, "%*d %ld", &pages) != 1)
    pages = 0;
  if (file)
    fclose(file);
  *resident = (double)pages * (double)sysconf(_SC_PAGESIZE);
  struct stat facts; /* since Linux 6.2 its size is the count */
  *files = stat("/proc/self/fd", &facts) == 0 ? (double)facts.st_size : 0;
}

static char *metrics_text(struct lod_service *service, const struct lod_jobs_counts *jobs, const struct lod_pool_counts *pool,
                          size_t *size) {
  const struct lod_metric_row ends[] = {{"done", (double)jobs->workers_done},
                                        {"failed", (double)jobs->workers_failed},
                                        {"crashed", (double)jobs->workers_crashed},
                                        {"killed", (double)jobs->workers_killed},
                                        {"stopped", (double)jobs->workers_stopped}};
  struct lod_metric_row stages[LOD_STAGES_MAX];
  for (uint32_t i = 0; i < jobs->stages.count; i++)
    stages[i] = (struct lod_metric_row){jobs->stages.list[i].name, jobs->stages.list[i].seconds};
  const struct lod_metric_row waits[] = {{"first", jobs->first_wait_seconds}, {"later", jobs->later_wait_seconds}};
  const struct lod_metric_row outcomes[] = {{"answered", (double)pool->answered},   {"failed", (double)pool->failed},
                                            {"crashed", (double)pool->crashed},     {"late", (double)pool->late},
                                            {"cancelled", (double)pool->cancelled}, {"refused", (double)pool->refused}};
  const struct lod_metric_row hits[] = {{"memory", (double)atomic_load(&service->refined_memory_hits)},
                                        {"store", (double)atomic_load(&service->refined_store_hits)},
                                        {"flight", service->errands ? (double)lod_errands_shared(service->errands) : 0}};
  struct lod_metric_row refine_ends[LOD_POOL_ENDS];
  for (int i = 0; i < LOD_POOL_ENDS; i++)
    refine_ends[i] = (struct lod_metric_row){lod_pool_end_name((enum lod_pool_end)i), (double)pool->ends[i]};
  const struct lod_metric_family families[] = {
      {"lodestream_worker_ends_total", "Workers that ended, by cause.", "cause", ends, sizeof ends / sizeof *ends},
      {"lodestream_bake_wait_seconds_total",
       "Seconds that bakes waited for a worker before they began; first: of models that were not served yet.", "bake", waits,
       sizeof waits / sizeof *waits},
      {"lodestream_bake_stage_seconds_total", "Seconds that bakes were in each stage; a family's stage has its name.", "stage", stages,
       jobs->stages.count},
      {"lodestream_refine_requests_total", "Refinements and contacts that a worker was asked for, by outcome; refused: the queue was full.",
       "outcome", outcomes, sizeof outcomes / sizeof *outcomes},
      {"lodestream_refine_hits_total", "Refinements answered without a worker: from memory, from the store, with an equal one in flight.",
       "from", hits, sizeof hits / sizeof *hits},
      {"lodestream_refine_worker_ends_total", "Warm workers that ended and were replaced, by cause.", "cause", refine_ends, LOD_POOL_ENDS},
  };
  return lod_metrics_text(service->metrics, families, sizeof families / sizeof *families, size);
}

void lod_answer_metrics(struct lod_exchange *exchange) {
  struct lod_service *service = exchange->service;
  struct lod_metrics *metrics = service->metrics;
  struct lod_jobs_counts jobs = lod_jobs_counts(service->jobs);
  struct lod_cache_counts objects = lod_cache_counts(service->objects);
  struct lod_cache_counts responses = lod_cache_counts(service->responses), memos = lod_cache_counts(service->memos);
  struct lod_pool_counts pool = service->pool ? lod_pool_counts(service->pool) : (struct lod_pool_counts){0};
  struct lod_answers_counts answers = lod_answers_counts(lod_store_answers(service->store));
  double cpu, resident, files;
  measure_process(&cpu, &resident, &files);
  const struct {
    enum lod_metric metric;
    double value;
  } now[] = {
      {LOD_METRIC_STORE_BYTES, (double)lod_store_bytes(service->store)},
      {LOD_METRIC_CPU_SECONDS, cpu},
      {LOD_METRIC_RESIDENT_BYTES, resident},
      {LOD_METRIC_OPEN_FILES, files},
      {LOD_METRIC_MODELS, (double)lod_store_model_count(service->store)},
      {LOD_METRIC_JOBS_QUEUED, (double)jobs.queued},
      {LOD_METRIC_JOBS_RUNNING, (double)jobs.running},
      {LOD_METRIC_JOBS_LATER_QUEUED, (double)jobs.queued_later},
      {LOD_METRIC_JOBS_LATER_RUNNING, (double)jobs.running_later},
      {LOD_METRIC_JOBS_DONE, (double)jobs.done},
      {LOD_METRIC_JOBS_FAILED, (double)jobs.failed},
      {LOD_METRIC_JOBS_RETRIED, (double)jobs.retried},
      {LOD_METRIC_WORKERS_CRASHED, (double)jobs.workers_crashed},
      {LOD_METRIC_WORKERS_KILLED, (double)jobs.workers_killed},
      {LOD_METRIC_BAKE_SECONDS, jobs.bake_seconds},
      {LOD_METRIC_OBJECTS_CACHED, (double)objects.entries},
      {LOD_METRIC_OBJECT_HITS, (double)objects.hits},
      {LOD_METRIC_OBJECT_MISSES, (double)objects.misses},
      {LOD_METRIC_RESPONSES_CACHED, (double)responses.entries},
      {LOD_METRIC_RESPONSE_HITS, (double)(responses.hits + memos.hits)},
      {LOD_METRIC_RESPONSE_MISSES, (double)responses.misses},
      {LOD_METRIC_REFINE_WORKERS, (double)pool.alive},
      {LOD_METRIC_REFINE_BUSY, (double)pool.running},
      {LOD_METRIC_REFINE_QUEUED, (double)pool.waiting},
      {LOD_METRIC_REFINE_SECONDS, pool.seconds},
      {LOD_METRIC_REFINE_WAIT_SECONDS, pool.wait_seconds},
      {LOD_METRIC_REFINED_FILES, (double)answers.files},
      {LOD_METRIC_REFINED_BYTES, (double)answers.bytes},
      {LOD_METRIC_REFINED_EVICTED, (double)answers.evicted},
      {LOD_METRIC_DRAINING, atomic_load(&service->draining) ? 1 : 0},
  };
  for (size_t i = 0; i < sizeof now / sizeof *now; i++)
    lod_metrics_set(metrics, now[i].metric, now[i].value);
  size_t size = 0;
  char *text = metrics_text(service, &jobs, &pool, &size);
  struct lod_reply *reply = &exchange->reply;
  reply->body = lod_body_take(text, size);
  if (!reply->body) {
    lod_reply_problem(reply, 500, "memory", "The server is out of memory.", "");
    return;
  }
  reply->status = 200;
  reply->cache = LOD_CACHE_NO_STORE;
  reply->type = "text/plain; version=0.0.4; charset=utf-8";
  reply->compress = true;
}

void lod_answer_openapi(struct lod_exchange *exchange) {
  struct lod_reply *reply = &exchange->reply;
  reply->status = 200;
  reply->cache = LOD_CACHE_REVALIDATE;
  reply->type = "application/json";
  reply->body = lod_body_retain(exchange->service->openapi);
  lod_etag_of_bytes(reply->body->bytes, reply->body->size, reply->etag);
  reply->shared = reply->compress = true;
}

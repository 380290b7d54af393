#include "server/metrics.h"

#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>

enum kind { COUNTER, GAUGE };
static const struct {
  const char *name;
  enum kind kind;
  bool fraction; /* the value is a double's bits: only set, never added to */
  const char *help;
} kMetrics[LOD_METRIC_COUNT] = {
    [LOD_METRIC_START_TIME] = {"process_start_time_seconds", GAUGE, true, "When the daemon started, in seconds since 1970."},
    [LOD_METRIC_CONNECTIONS] = {"lodestream_http_connections", GAUGE, false, "Open connections."},
    [LOD_METRIC_CONNECTIONS_ACCEPTED] = {"lodestream_http_connections_accepted_total", COUNTER, false, "Connections accepted."},
    [LOD_METRIC_STREAMS] = {"lodestream_http_event_streams", GAUGE, false, "Open streams of job events."},
    [LOD_METRIC_DRAINING] = {"lodestream_http_draining", GAUGE, false, "1 while the daemon finishes what it began before it stops."},
    [LOD_METRIC_BODY_BYTES_SENT] = {"lodestream_http_body_sent_bytes_total", COUNTER, false, "Bytes of bodies sent whole."},
    [LOD_METRIC_BODY_BYTES_RECEIVED] = {"lodestream_http_body_received_bytes_total", COUNTER, false, "Bytes of uploaded bodies."},
    [LOD_METRIC_NOT_MODIFIED] = {"lodestream_http_not_modified_total", COUNTER, false, "Answers 304: bodies that were not sent again."},
    [LOD_METRIC_PARTIAL] = {"lodestream_http_partial_total", COUNTER, false, "Answers 206."},
    [LOD_METRIC_OBJECTS_CACHED] = {"lodestream_objects_cached", GAUGE, false, "Objects that are mapped and kept."},
    [LOD_METRIC_OBJECT_HITS] = {"lodestream_object_cache_hits_total", COUNTER, false, "Objects found mapped."},
    [LOD_METRIC_OBJECT_MISSES] = {"lodestream_object_cache_misses_total", COUNTER, false, "Objects that had to be opened or do not exist."},
    [LOD_METRIC_RESPONSES_CACHED] = {"lodestream_responses_cached", GAUGE, false, "Prepared responses kept."},
    [LOD_METRIC_RESPONSE_HITS] = {"lodestream_response_cache_hits_total", COUNTER, false, "Answers from a prepared response."},
    [LOD_METRIC_RESPONSE_MISSES] = {"lodestream_response_cache_misses_total", COUNTER, false,
                                    "Answers for which a response had to be prepared."},
    [LOD_METRIC_STORE_BYTES] = {"lodestream_store_objects_bytes", GAUGE, false, "Bytes of all objects in the store."},
    [LOD_METRIC_CPU_SECONDS] = {"process_cpu_seconds_total", COUNTER, true, "Processor seconds of the daemon, without its workers."},
    [LOD_METRIC_RESIDENT_BYTES] = {"process_resident_memory_bytes", GAUGE, false, "Memory of the daemon, mapped objects included."},
    [LOD_METRIC_OPEN_FILES] = {"process_open_fds", GAUGE, false, "Open descriptors of the daemon."},
    [LOD_METRIC_MODELS] = {"lodestream_models", GAUGE, false, "Models in the store."},
    [LOD_METRIC_JOBS_QUEUED] = {"lodestream_jobs_queued", GAUGE, false, "Bakes that wait."},
    [LOD_METRIC_JOBS_RUNNING] = {"lodestream_jobs_running", GAUGE, false, "Bakes in progress."},
    [LOD_METRIC_JOBS_LATER_QUEUED] = {"lodestream_jobs_later_queued", GAUGE, false,
                                      "Of the bakes that wait: those that add later families."},
    [LOD_METRIC_JOBS_LATER_RUNNING] = {"lodestream_jobs_later_running", GAUGE, false,
                                       "Of the bakes in progress: those that add later families."},
    [LOD_METRIC_JOBS_DONE] = {"lodestream_jobs_done_total", COUNTER, false, "Bakes done since the start."},
    [LOD_METRIC_JOBS_FAILED] = {"lodestream_jobs_failed_total", COUNTER, false, "Bakes failed since the start."},
    [LOD_METRIC_JOBS_RETRIED] = {"lodestream_jobs_retried_total", COUNTER, false, "Bakes run again after a restart."},
    [LOD_METRIC_WORKERS_CRASHED] = {"lodestream_workers_crashed_total", COUNTER, false,
                                    "Workers that ended by a signal of their own making."},
    [LOD_METRIC_WORKERS_KILLED] = {"lodestream_workers_killed_total", COUNTER, false, "Workers stopped for a deadline or a limit."},
    [LOD_METRIC_BAKE_SECONDS] = {"lodestream_bake_seconds_total", COUNTER, true, "Seconds that finished bakes took."},
    [LOD_METRIC_REFINE_WORKERS] = {"lodestream_refine_workers", GAUGE, false, "Warm workers for refinements that are alive."},
    [LOD_METRIC_REFINE_BUSY] = {"lodestream_refine_workers_busy", GAUGE, false, "Warm workers that refine."},
    [LOD_METRIC_REFINE_QUEUED] = {"lodestream_refine_queued", GAUGE, false, "Refinements that wait for a worker."},
    [LOD_METRIC_REFINE_SECONDS] = {"lodestream_refine_seconds_total", COUNTER, true, "Seconds that workers spent on refinements."},
    [LOD_METRIC_REFINE_WAIT_SECONDS] = {"lodestream_refine_wait_seconds_total", COUNTER, true,
                                        "Seconds that refinements waited for a worker."},
    [LOD_METRIC_REFINED_FILES] = {"lodestream_refined_files", GAUGE, false, "Refinements kept in the store's cache."},
    [LOD_METRIC_REFINED_BYTES] = {"lodestream_refined_bytes", GAUGE, false, "Bytes of these; no object's."},
    [LOD_METRIC_REFINED_EVICTED] = {"lodestream_refined_evicted_total", COUNTER, false,
                                    "Refinements that had to go from the store's cache for newer ones."},
};

/* Statuses that are told apart; the last stands for all others. */
static const unsigned kStatuses[] = {200, 202, 204, 206, 304, 400, 401, 404, 405, 412, 413, 416, 422, 500, 503, 0};
enum { STATUS_COUNT = sizeof kStatuses / sizeof *kStatuses };

/* Upper ends of the latency buckets: 50 us to 10 s. */
static const double kBuckets[] = {0.00005, 0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10};
enum { BUCKET_COUNT = sizeof kBuckets / sizeof *kBuckets };

struct route_counts {
  atomic_uint_fast64_t statuses[STATUS_COUNT], buckets[BUCKET_COUNT + 1], nanoseconds;
};

struct lod_metrics {
  const char *const *routes, *const *cuts;
  uint32_t route_count, cut_count;
  _Atomic int64_t values[LOD_METRIC_COUNT];
  _Atomic double fractions[LOD_METRIC_COUNT];
  atomic_uint_fast64_t *cut_counts;
  struct route_counts *route_counts;
};

struct lod_metrics *lod_metrics_create(const char *const *routes, uint32_t route_count, const char *const *cuts, uint32_t cut_count) {
  struct lod_metrics *metrics = calloc(1, sizeof *metrics);
  if (!metrics)
    return NULL;
  metrics->routes = routes;
  metrics->route_count = route_count;
  metrics->cuts = cuts;
  metrics->cut_count = cut_count;
  metrics->route_counts = calloc(route_count, sizeof *metrics->route_counts);
  metrics->cut_counts = calloc(cut_count, sizeof *metrics->cut_counts);
  if (metrics->route_counts && metrics->cut_counts)
    return metrics;
  lod_metrics_destroy(metrics);
  return NULL;
}

void lod_metrics_destroy(struct lod_metrics *metrics) {
  if (!metrics)
    return;
  free(metrics->route_counts);
  free(metrics->cut_counts);
  free(metrics);
}

void lod_metrics_add(struct lod_metrics *metrics, enum lod_metric metric, int64_t amount) {
  atomic_fetch_add_explicit(&metrics->values[metric], amount, memory_order_relaxed);
}

void lod_metrics_set(struct lod_metrics *metrics, enum lod_metric metric, double value) {
  if (kMetrics[metric].fraction)
    atomic_store_explicit(&metrics->fractions[metric], value, memory_order_relaxed);
  else
    atomic_store_explicit(&metrics->values[metric], (int64_t)value, memory_order_relaxed);
}

void lod_metrics_request(struct lod_metrics *metrics, uint32_t route, unsigned status, double seconds) {
  struct route_counts *counts = &metrics->route_counts[route];
  size_t slot = 0, bucket = 0;
  while (slot + 1 < STATUS_COUNT && kStatuses[slot] != status)
    slot++;
  while (bucket < BUCKET_COUNT && seconds > kBuckets[bucket])
    bucket++;
  atomic_fetch_add_explicit(&counts->statuses[slot], 1, memory_order_relaxed);
  atomic_fetch_add_explicit(&counts->buckets[bucket], 1, memory_order_relaxed);
  atomic_fetch_add_explicit(&counts->nanoseconds, (uint64_t)(seconds * 1e9), memory_order_relaxed);
}

void lod_metrics_cut(struct lod_metrics *metrics, uint32_t reason) {
  atomic_fetch_add_explicit(&metrics->cut_counts[reason], 1, memory_order_relaxed);
}

static void write_requests(struct lod_metrics *metrics, FILE *out) {
  const char *name = "lodestream_http_requests_total";
  fprintf(out, "# HELP %s Requests finished, by route and status.\n# TYPE %s counter\n", name, name);
  for (uint32_t i = 0; i < metrics->route_count; i++)
    for (size_t j = 0; j < STATUS_COUNT; j++) {
      uint64_t count = atomic_load_explicit(&metrics->route_counts[i].statuses[j], memory_order_relaxed);
      if (!count)
        continue;
      if (kStatuses[j])
        fprintf(out, "%s{route=\"%s\",status=\"%u\"} %llu\n", name, metrics->routes[i], kStatuses[j], (unsigned long long)count);
      else
        fprintf(out, "%s{route=\"%s\",status=\"other\"} %llu\n", name, metrics->routes[i], (unsigned long long)count);
    }
  name = "lodestream_http_request_duration_seconds";
  fprintf(out, "# HELP %s Seconds from the request line to the last byte handed to the kernel, by route.\n# TYPE %s histogram\n", name,
          name);
  for (uint32_t i = 0; i < metrics->route_count; i++) {
    uint64_t sum = 0, total = 0;
    for (size_t j = 0; j <= BUCKET_COUNT; j++)
      total += atomic_load_explicit(&metrics->route_counts[i].buckets[j], memory_order_relaxed);
    if (!total)
      continue;
    for (size_t j = 0; j < BUCKET_COUNT; j++) {
      sum += atomic_load_explicit(&metrics->route_counts[i].buckets[j], memory_order_relaxed);
      fprintf(out, "%s_bucket{route=\"%s\",le=\"%g\"} %llu\n", name, metrics->routes[i], kBuckets[j], (unsigned long long)sum);
    }
    double seconds = 1e-9 * (double)atomic_load_explicit(&metrics->route_counts[i].nanoseconds, memory_order_relaxed);
    fprintf(out, "%s_bucket{route=\"%s\",le=\"+Inf\"} %llu\n%s_sum{route=\"%s\"} %.9g\n%s_count{route=\"%s\"} %llu\n", name,
            metrics->routes[i], (unsigned long long)total, name, metrics->routes[i], seconds, name, metrics->routes[i],
            (unsigned long long)total);
  }
}

char *lod_metrics_text(struct lod_metrics *metrics, const struct lod_metric_family *families, uint32_t family_count, size_t *size) {
  char *text = NULL;
  FILE *out = open_memstream(&text, size);
  if (!out)
    return NULL;
  fprintf(out,
          "# HELP lodestream_build_info 1; the label is the version.\n# TYPE lodestream_build_info "
          "gauge\nlodestream_build_info{version=\"%s\"} 1\n",
          LOD_VERSION);
  for (size_t i = 0; i < LOD_METRIC_COUNT; i++) {
    fprintf(out, "# HELP %s %s\n# TYPE %s %s\n", kMetrics[i].name, kMetrics[i].help, kMetrics[i].name,
            kMetrics[i].kind == COUNTER ? "counter" : "gauge");
    if (kMetrics[i].fraction)
      fprintf(out, "%s %.3f\n", kMetrics[i].name, atomic_load_explicit(&metrics->fractions[i], memory_order_relaxed));
    else
      fprintf(out, "%s %lld\n", kMetrics[i].name, (long long)atomic_load_explicit(&metrics->values[i], memory_order_relaxed));
  }
  const char *name = "lodestream_http_connections_cut_total";
  fprintf(out, "# HELP %s Connections cut, by reason.\n# TYPE %s counter\n", name, name);
  for (uint32_t i = 0; i < metrics->cut_count; i++)
    fprintf(out, "%s{reason=\"%s\"} %llu\n", name, metrics->cuts[i],
            (unsigned long long)atomic_load_explicit(&metrics->cut_counts[i], memory_order_relaxed));
  write_requests(metrics, out);
  for (uint32_t i = 0; i < family_count; i++) {
    const struct lod_metric_family *family = &families[i];
    fprintf(out, "# HELP %s %s\n# TYPE %s counter\n", family->name, family->help, family->name);
    for (uint32_t k = 0; k < family->row_count; k++)
      fprintf(out, "%s{%s=\"%s\"} %.9g\n", family->name, family->label, family->rows[k].value, family->rows[k].count);
  }
  bool good = !ferror(out);
  if (fclose(out) != 0 || !good) {
    free(text);
    return NULL;
  }
  return text;
}

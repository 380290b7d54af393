/* What the daemon counts, for Prometheus. Every metric is declared once, in metrics.c, with kind, unit and a sentence. Any thread may
 * count. */
#ifndef LOD_SERVER_METRICS_H
#define LOD_SERVER_METRICS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Without labels. A value counts up from 0, or is set as it is now; seconds and other fractions are doubles. */
enum lod_metric {
  LOD_METRIC_START_TIME,
  LOD_METRIC_CONNECTIONS,
  LOD_METRIC_CONNECTIONS_ACCEPTED,
  LOD_METRIC_STREAMS,
  LOD_METRIC_DRAINING,
  LOD_METRIC_BODY_BYTES_SENT,
  LOD_METRIC_BODY_BYTES_RECEIVED,
  LOD_METRIC_NOT_MODIFIED,
  LOD_METRIC_PARTIAL,
  LOD_METRIC_OBJECTS_CACHED,
  LOD_METRIC_OBJECT_HITS,
  LOD_METRIC_OBJECT_MISSES,
  LOD_METRIC_RESPONSES_CACHED,
  LOD_METRIC_RESPONSE_HITS,
  LOD_METRIC_RESPONSE_MISSES,
  LOD_METRIC_STORE_BYTES,
  LOD_METRIC_CPU_SECONDS,
  LOD_METRIC_RESIDENT_BYTES,
  LOD_METRIC_OPEN_FILES,
  LOD_METRIC_MODELS,
  LOD_METRIC_JOBS_QUEUED,
  LOD_METRIC_JOBS_RUNNING,
  LOD_METRIC_JOBS_LATER_QUEUED,
  LOD_METRIC_JOBS_LATER_RUNNING,
  LOD_METRIC_JOBS_DONE,
  LOD_METRIC_JOBS_FAILED,
  LOD_METRIC_JOBS_RETRIED,
  LOD_METRIC_WORKERS_CRASHED,
  LOD_METRIC_WORKERS_KILLED,
  LOD_METRIC_BAKE_SECONDS,
  LOD_METRIC_REFINE_WORKERS,
  LOD_METRIC_REFINE_BUSY,
  LOD_METRIC_REFINE_QUEUED,
  LOD_METRIC_REFINE_SECONDS,
  LOD_METRIC_REFINE_WAIT_SECONDS,
  LOD_METRIC_REFINED_FILES,
  LOD_METRIC_REFINED_BYTES,
  LOD_METRIC_REFINED_EVICTED,
  LOD_METRIC_COUNT,
};

struct lod_metrics;

/* routes: names for the label `route`, borrowed; cuts: names for the label `reason`, borrowed. NULL: memory. */
struct lod_metrics *lod_metrics_create(const char *const *routes, uint32_t route_count, const char *const *cuts, uint32_t cut_count);
void lod_metrics_destroy(struct lod_metrics *metrics);

void lod_metrics_add(struct lod_metrics *metrics, enum lod_metric metric, int64_t amount);
void lod_metrics_set(struct lod_metrics *metrics, enum lod_metric metric, double value);
/* A finished request. */
void lod_metrics_request(struct lod_metrics *metrics, uint32_t route, unsigned status, double seconds);
/* A connection that was cut. */
void lod_metrics_cut(struct lod_metrics *metrics, uint32_t reason);

/* A counter with one label, as it is now. */
struct lod_metric_family {
  const char *name, *help, *label;
  const struct lod_metric_row {
    const char *value; /* of the label: our own, or checked: nothing in it is escaped */
    double count;
  } * rows;
  uint32_t row_count;
};

/* Prometheus text format 0.0.4 of everything, then of `families`; malloc'd; NULL: memory. */
char *lod_metrics_text(struct lod_metrics *metrics, const struct lod_metric_family *families, uint32_t family_count, size_t *size);

#endif

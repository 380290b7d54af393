/* Jobs, and their changes as server-sent events (WHATWG HTML, 9.2). */
#include <inttypes.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "server/http/routes.h"

static const char *const kStates[] = {"queued", "running", "done", "failed"};

char *lod_job_json(const struct lod_job *job) {
  json_t *object = json_pack("{s:I, s:s, s:s, s:s, s:f, s:f}", "job", (json_int_t)job->number, "id", job->id, "state", kStates[job->state],
                             "stage", job->stage, "progress", job->progress, "created", job->created);
  if (object && job->finished > 0)
    json_object_set_new(object, "finished", json_real(job->finished));
  if (object && job->next != 0)
    json_object_set_new(object, "next", json_integer((json_int_t)job->next));
  if (object && job->state == LOD_JOB_FAILED) {
    char *text = lod_problem_json(lod_status_http(&job->problem), job->problem.type, job->problem.detail, "");
    if (text)
      json_object_set_new(object, "problem", json_loads(text, 0, NULL));
    free(text);
  }
  char *text = object ? json_dumps(object, JSON_COMPACT) : NULL;
  json_decref(object);
  return text;
}

/* False, and 404, when there is no such job. */
static bool find_job(struct lod_exchange *exchange, struct lod_job *job) {
  uint64_t number = strtoull(exchange->target.segments[2], NULL, 10);
  if (lod_jobs_find(exchange->service->jobs, number, job))
    return true;
  lod_reply_problem(&exchange->reply, 404, "unknown-job", "There is no such job, or it ended long ago.", "");
  return false;
}

void lod_answer_job(struct lod_exchange *exchange) {
  struct lod_job job;
  if (find_job(exchange, &job))
    lod_reply_json(&exchange->reply, 200, LOD_CACHE_NO_STORE, lod_job_json(&job));
}

/* ---- events ---- */

struct events {
  struct lod_service *service;
  uint64_t number, seen_changes, events;
  struct lod_job last;
  bool begun, ended;
  time_t written;
  char *pending; /* a malloc'd event of which `sent` of `size` bytes were sent */
  size_t size, sent;
};

static void events_finish(void *context) {
  struct events *events = context;
  lod_metrics_add(events->service->metrics, LOD_METRIC_STREAMS, -1);
  free(events->pending);
  free(events);
}

static time_t monotonic_seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec;
}

static bool job_changed(const struct lod_job *a, const struct lod_job *b) {
  return a->state != b->state || a->progress != b->progress || strcmp(a->stage, b->stage) != 0;
}

/* Prepares the next event when there is one: a change, or a comment that keeps the connection alive. */
static void prepare_event(struct events *events) {
  enum { HEARTBEAT_SECONDS = 10 };
  time_t now = monotonic_seconds();
  uint64_t changes = atomic_load(&events->service->job_changes);
  char *text = NULL;
  if (!events->begun || changes != events->seen_changes) {
    struct lod_job job;
    events->seen_changes = changes;
    if (!lod_jobs_find(events->service->jobs, events->number, &job)) {
      events->ended = true;
      return;
    }
    if (!events->begun || job_changed(&job, &events->last)) {
      char *json = lod_job_json(&job);
      if (!json ||
          asprintf(&text, "%sevent: job\nid: %" PRIu64 "\ndata: %s\n\n", events->begun ? "" : "retry: 2000\n", ++events->events, json) < 0)
        text = NULL;
      free(json);
      events->ended = !text || job.state == LOD_JOB_DONE || job.state == LOD_JOB_FAILED;
      events->begun = true;
      events->last = job;
    }
  }
  if (!text && !events->ended && now - events->written >= HEARTBEAT_SECONDS)
    text = strdup(": still here\n\n");
  if (!text)
    return;
  free(events->pending);
  events->pending = text;
  events->size = strlen(text);
  events->sent = 0;
  events->written = now;
}

static ssize_t events_read(void *context, char *buffer, size_t size) {
  struct events *events = context;
  if (events->sent == events->size) {
    if (events->ended || atomic_load(&events->service->draining))
      return -1;
    prepare_event(events);
  }
  size_t rest = events->size - events->sent;
  size_t count = rest < size ? rest : size;
  if (count == 0)
    return events->ended ? -1 : 0;
  memcpy(buffer, events->pending + events->sent, count);
  events->sent += count;
  return (ssize_t)count;
}

void lod_answer_job_events(struct lod_exchange *exchange) {
  struct lod_reply *reply = &exchange->reply;
  struct lod_job job;
  if (!find_job(exchange, &job))
    return;
  struct events *events = calloc(1, sizeof *events);
  if (!events) {
    lod_reply_problem(reply, 503, "memory", "The server is out of memory.", "");
    return;
  }
  events->service = exchange->service;
  events->number = job.number;
  lod_metrics_add(exchange->service->metrics, LOD_METRIC_STREAMS, 1);
  reply->status = 200;
  reply->cache = LOD_CACHE_NO_STORE;
  reply->type = "text/event-stream";
  reply->stream = (struct lod_stream){events_read, events_finish, events};
  lod_reply_header(reply, "X-Accel-Buffering", "no"); /* nginx would hold events back */
}

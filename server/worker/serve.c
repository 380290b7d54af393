#include "server/worker/serve.h"

#include <errno.h>
#include <jansson.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>

#include "server/jobs/frame.h"
#include "server/worker/bake.h"
#include "server/worker/jail.h"
#include "server/worker/refine.h"

static bool send_json(char type, json_t *json) {
  char *text = json == NULL ? NULL : json_dumps(json, JSON_COMPACT);
  json_decref(json);
  bool sent = text != NULL && lod_frame_write(LOD_WORKER_SOCKET_FD, type, text, strlen(text)) == LOD_OK;
  free(text);
  return sent;
}

static bool send_problem(const struct lod_problem *problem) {
  json_t *detail = json_string(problem->detail); /* may quote bytes of the file that are not UTF-8 */
  if (detail == NULL)
    detail = json_string("The model is wrong in a way whose description is not UTF-8.");
  return send_json('F', json_pack("{ss ss so}", "status", lod_status_name(problem->status), "type", problem->type, "detail", detail));
}

/* Progress goes out at most ten times a second; a socket that is gone means nobody waits for the result. */
struct reporting {
  pthread_mutex_t lock;
  struct timespec last;
  const char *stage;
  bool gone;
};

static void report(void *context, const char *stage, double fraction) {
  struct reporting *reporting = context;
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  pthread_mutex_lock(&reporting->lock);
  double since = (double)(now.tv_sec - reporting->last.tv_sec) + 1e-9 * (double)(now.tv_nsec - reporting->last.tv_nsec);
  if (stage != reporting->stage || since >= 0.1) {
    reporting->last = now;
    reporting->stage = stage;
    reporting->gone = reporting->gone || !send_json('P', json_pack("{ss sf}", "stage", stage, "progress", fraction));
  }
  pthread_mutex_unlock(&reporting->lock);
}

static bool cancelled(void *context) {
  struct reporting *reporting = context;
  pthread_mutex_lock(&reporting->lock);
  bool gone = reporting->gone;
  pthread_mutex_unlock(&reporting->lock);
  return gone;
}

/* *text: the frame's payload, malloc'd. */
static enum lod_status read_job(json_t **job, char **text, struct lod_problem *problem) {
  struct lod_frame_reader reader = {0};
  char type = 0;
  enum lod_status status = lod_frame_read(LOD_WORKER_SOCKET_FD, &reader, &type);
  *job = NULL;
  if (status == LOD_OK && type == 'J')
    *job = json_loadb(reader.payload, reader.payload_size, JSON_REJECT_DUPLICATES, NULL);
  *text = *job == NULL ? NULL : strdup(reader.payload);
  lod_frame_reader_finish(&reader);
  if (*job == NULL)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-frame", "The worker expected one 'J' frame with a JSON object on descriptor %d.",
                    LOD_WORKER_SOCKET_FD);
  return LOD_OK;
}

static uint64_t count_of(const json_t *object, const char *name, uint64_t otherwise) {
  const json_t *value = json_object_get(object, name);
  return json_is_integer(value) && json_integer_value(value) >= 0 ? (uint64_t)json_integer_value(value) : otherwise;
}

static uint32_t narrow(uint64_t value) {
  return value > UINT32_MAX ? UINT32_MAX : (uint32_t)value;
}

/* Strings in the request belong to `job`. */
static struct lod_bake_request request_of(const json_t *job) {
  struct lod_bake_request request = lod_bake_defaults();
  const char *text = json_string_value(json_object_get(job, "id"));
  if (text != NULL)
    request.id = request.name = text;
  text = json_string_value(json_object_get(job, "name"));
  if (text != NULL)
    request.name = text;
  request.format = json_string_value(json_object_get(job, "format"));
  size_t i;
  json_t *family;
  json_array_foreach(json_object_get(job, "families"), i, family) {
    if (json_is_string(family) && request.family_count < LOD_BAKE_MAX_FAMILIES)
      request.families[request.family_count++] = json_string_value(family);
  }
  json_t *option;
  json_array_foreach(json_object_get(job, "envelope"), i, option) {
    if (json_is_string(option) && request.envelope_option_count < LOD_BAKE_MAX_LIST)
      request.envelope_options[request.envelope_option_count++] = json_string_value(option);
  }
  request.threads = narrow(count_of(job, "threads", 0));
  const json_t *limits = json_object_get(job, "limits");
  struct lod_import_limits *l = &request.limits;
  l->max_bytes = count_of(limits, "bytes", l->max_bytes);
  l->max_vertices = count_of(limits, "vertices", l->max_vertices);
  l->max_triangles = count_of(limits, "triangles", l->max_triangles);
  l->max_instances = narrow(count_of(limits, "instances", l->max_instances));
  l->max_depth = narrow(count_of(limits, "depth", l->max_depth));
  l->max_texture_pixels = narrow(count_of(limits, "texture_pixels", l->max_texture_pixels));
  l->max_texture_bytes = count_of(limits, "texture_bytes", l->max_texture_bytes);
  request.max_memory_bytes = count_of(limits, "memory_bytes", 0);
  request.directory_fd = LOD_WORKER_OUTPUT_FD;
  return request;
}

static enum lod_status bake(const json_t *job, struct lod_problem *problem) {
  struct stat st;
  if (fstat(LOD_WORKER_INPUT_FD, &st) != 0 || !S_ISREG(st.st_mode))
    return lod_fail(problem, LOD_IO, "bad-descriptor", "The worker expected the model file on descriptor %d.", LOD_WORKER_INPUT_FD);
  struct lod_bake_request request = request_of(job);
  void *bytes = NULL;
  if (st.st_size > 0) {
    bytes = mmap(NULL, (size_t)st.st_size, PROT_READ, MAP_PRIVATE, LOD_WORKER_INPUT_FD, 0);
    if (bytes == MAP_FAILED)
      return lod_fail(problem, LOD_IO, "cannot-open", "Cannot map the upload: %s.", strerror(errno));
  }
  struct reporting reporting = {.lock = PTHREAD_MUTEX_INITIALIZER};
  struct lod_progress progress = {.report = report, .cancelled = cancelled, .context = &reporting};
  request.bytes = bytes;
  request.size = (size_t)st.st_size;
  request.progress = &progress;
  enum lod_status status = lod_bake_run(&request, problem);
  if (bytes != NULL)
    munmap(bytes, (size_t)st.st_size);
  return status;
}

int lod_worker_serve(void) {
  struct lod_problem problem = {0};
  json_t *job = NULL;
  char *text = NULL;
  struct lod_jail_settings jail = lod_jail_defaults();
  enum lod_status status = lod_jail_enter(&jail, NULL, &problem);
  if (status == LOD_OK)
    status = read_job(&job, &text, &problem);
  const char *kind = json_string_value(json_object_get(job, "job"));
  if (status == LOD_OK && kind != NULL && text != NULL && strcmp(kind, "refine") == 0) {
    int code = lod_refine_serve(text);
    json_decref(job);
    free(text);
    return code;
  }
  free(text);
  const bool tried = kind != NULL && strcmp(kind, "try") == 0; /* the daemon wants to know whether a worker comes as far as this */
  if (status == LOD_OK && !tried)
    status = bake(job, &problem);
  if (status != LOD_OK && problem.status == LOD_OK)
    lod_fail(&problem, status, "failed", "The bake failed (%s).", lod_status_name(status));
  bool sent = status == LOD_OK ? send_json('D', json_object()) : send_problem(&problem);
  json_decref(job);
  return sent ? 0 : 1;
}

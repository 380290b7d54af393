/* Models: list, manifest, upload, delete. */
#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>
#include <unistd.h>

#include "server/http/routes.h"

/* ---- list and manifest ---- */

static json_t *model_json(const struct lod_stored_model *model) {
  json_t *families = json_array();
  for (uint32_t i = 0; families && i < model->family_count; i++)
    json_array_append_new(families,
                          json_pack("{s:s, s:i}", "name", model->families[i].name, "levels", (int)model->families[i].level_count));
  return json_pack("{s:s, s:s, s:f, s:I, s:I, s:f, s:o}", "id", model->id, "revision", model->revision, "created", model->created, "bytes",
                   (json_int_t)model->bytes, "triangles", (json_int_t)model->triangles, "diagonal", model->diagonal, "families", families);
}

void lod_answer_models(struct lod_exchange *exchange) {
  enum { LIMIT_MAX = 1000, LIMIT_DEFAULT = 100 };
  const char *limit_text = lod_target_find(&exchange->target, "limit"), *after = lod_target_find(&exchange->target, "after");
  struct lod_query_problem problem = {0};
  uint64_t limit = LIMIT_DEFAULT;
  enum lod_status status = limit_text ? lod_parameter_integer("limit", limit_text, 1, LIMIT_MAX, &limit, &problem) : LOD_OK;
  if (status == LOD_OK && after && *after && !lod_model_id_valid(after))
    status = lod_parameter_fail(&problem, "after", "'after' must be the id of a model, as a page's `next` gives it.");
  struct lod_stored_model **models = status == LOD_OK ? calloc(limit + 1, sizeof(struct lod_stored_model *)) : NULL;
  if (status == LOD_OK && !models)
    status = lod_fail_memory(&problem.problem);
  if (status != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
    return;
  }
  /* One more than is shown tells whether there is a next page. */
  size_t count = lod_store_model_list(exchange->service->store, after ? after : "", limit + 1, models);
  json_t *list = json_array(), *page = json_object();
  for (size_t i = 0; i < count && i < limit; i++)
    json_array_append_new(list, model_json(models[i]));
  json_object_set_new(page, "models", list);
  if (count > limit) {
    char next[64 + LOD_MODEL_ID_MAX];
    snprintf(next, sizeof next, "?limit=%llu&after=%s", (unsigned long long)limit, models[limit - 1]->id);
    json_object_set_new(page, "next", json_string(next));
  }
  for (size_t i = 0; i < count; i++)
    lod_store_model_release(models[i]);
  free(models);
  lod_reply_json(&exchange->reply, 200, LOD_CACHE_REVALIDATE, json_dumps(page, JSON_COMPACT));
  exchange->reply.shared = exchange->reply.status == 200; /* until any model changes */
  json_decref(page);
}

static void release_model(void *model) {
  lod_store_model_release(model);
}

void lod_answer_model(struct lod_exchange *exchange) {
  struct lod_reply *reply = &exchange->reply;
  struct lod_stored_model *model = lod_store_model_open(exchange->service->store, exchange->target.segments[2]);
  if (!model) {
    lod_exchange_unknown_model(exchange, exchange->target.segments[2]);
    return;
  }
  snprintf(reply->etag, sizeof reply->etag, "%s", model->manifest_etag);
  reply->body = lod_body_create(model->manifest, model->manifest_size, release_model, model);
  if (!reply->body) {
    lod_reply_problem(reply, 503, "memory", "The server is out of memory.", "");
    return;
  }
  reply->status = 200;
  reply->cache = LOD_CACHE_REVALIDATE;
  reply->type = "application/json";
  reply->shared = reply->compress = true;
}

/* ---- changes ---- */

/* False, and 412, when If-Match or If-None-Match forbid to change the model. */
static bool change_allowed(struct lod_exchange *exchange, const char *id) {
  struct lod_conditions conditions = lod_exchange_conditions(exchange);
  struct lod_stored_model *model =
      conditions.if_match || conditions.if_none_match ? lod_store_model_open(exchange->service->store, id) : NULL;
  /* A client that took gzip knows the manifest by that tag. */
  char zipped[LOD_ETAG_MAX] = "";
  if (model)
    snprintf(zipped, sizeof zipped, "%.*s-gzip\"", (int)strlen(model->manifest_etag) - 1, model->manifest_etag);
  bool plain_good = lod_conditions_allow_change(&conditions, model ? model->manifest_etag : NULL);
  bool zipped_good = lod_conditions_allow_change(&conditions, model ? zipped : NULL);
  bool allowed = conditions.if_match ? plain_good || zipped_good : plain_good && zipped_good;
  lod_store_model_release(model);
  if (!allowed)
    lod_reply_problem(&exchange->reply, 412, "precondition-failed",
                      "The model is not in the state that If-Match or If-None-Match asks for.", "");
  return allowed;
}

static void delete_model(struct lod_exchange *exchange) {
  const char *id = exchange->target.segments[2];
  struct lod_query_problem problem = {0};
  bool existed = false;
  if (lod_jobs_delete_model(exchange->service->jobs, id, &existed, &problem.problem) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
  else if (!existed)
    lod_exchange_unknown_model(exchange, id);
  else
    exchange->reply.status = 204;
  lod_service_trim(exchange->service);
}

void lod_answer_model_delete(struct lod_exchange *exchange) {
  if (change_allowed(exchange, exchange->target.segments[2]))
    exchange->work = delete_model;
}

/* ---- upload ---- */

struct upload {
  int fd; /* -1 once it was handed over */
  uint64_t size, flushed;
  char name[201], format[17];
};

static void upload_finish(void *state) {
  struct upload *upload = state;
  if (upload->fd >= 0)
    close(upload->fd);
  free(upload);
}

/* The last part of a path, without control characters. */
static void set_name(struct upload *upload, const char *name, size_t size) {
  for (size_t i = size; i > 0; i--)
    if (name[i - 1] == '/' || name[i - 1] == '\\') {
      name += i;
      size -= i;
      break;
    }
  snprintf(upload->name, sizeof upload->name, "%.*s", (int)(size < 200 ? size : 200), name);
  for (char *p = upload->name; *p; p++)
    if ((unsigned char)*p < 0x20 || *p == 0x7f)
      *p = '_';
}

/* ?name=, or filename= of Content-Disposition (RFC 6266, the plain form), or the id. */
static void choose_name(const struct lod_exchange *exchange, struct upload *upload) {
  const char *given = lod_target_find(&exchange->target, "name");
  const char *disposition = exchange->header(exchange->header_context, "Content-Disposition");
  if (given && *given)
    set_name(upload, given, strlen(given));
  else if (disposition && (disposition = strcasestr(disposition, "filename=")) != NULL) {
    disposition += strlen("filename=");
    if (*disposition == '"')
      set_name(upload, disposition + 1, strcspn(disposition + 1, "\""));
    else
      set_name(upload, disposition, strcspn(disposition, "; \t"));
  }
  if (!*upload->name)
    set_name(upload, exchange->target.segments[2], strlen(exchange->target.segments[2]));
}

static void refuse_size(struct lod_exchange *exchange) {
  char detail[200];
  snprintf(detail, sizeof detail, "The body is larger than %llu bytes, the most that this server takes.",
           (unsigned long long)exchange->service->config->upload_bytes);
  lod_reply_problem(&exchange->reply, 413, "upload-too-large", detail, "");
}

static void refuse_parameter(struct lod_exchange *exchange, const char *name, const char *detail) {
  struct lod_query_problem problem = {0};
  if (lod_parameter_fail(&problem, name, "%s", detail) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
}

static double monotonic_seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec;
}

/* False, and 429, when the token's share of the day does not hold so many bytes more. */
static bool take_share(struct lod_exchange *exchange, uint64_t bytes) {
  unsigned retry;
  if (!exchange->token || lod_token_take_bytes(exchange->token, bytes, monotonic_seconds(), &retry))
    return true;
  lod_reply_problem(&exchange->reply, 429, "upload-quota", "This token's uploads of the last 24 hours are as many bytes as it may send.",
                    "");
  lod_reply_header(&exchange->reply, "Retry-After", "%u", retry);
  return false;
}

void lod_begin_upload(struct lod_exchange *exchange) {
  struct lod_reply *reply = &exchange->reply;
  const struct lod_config *config = exchange->service->config;
  const char *id = exchange->target.segments[2], *format = lod_target_find(&exchange->target, "format");
  if (!lod_model_id_valid(id)) {
    refuse_parameter(exchange, "id", "A model's id is 1 to 128 of A-Z a-z 0-9 . _ - and does not begin with a dot or a dash.");
    return;
  }
  if (format && (!*format || strlen(format) > 16 || strspn(format, "abcdefghijklmnopqrstuvwxyz0123456789") != strlen(format))) {
    refuse_parameter(exchange, "format", "'format' must be the name of a file format in small letters, as in glb, ply or stl.");
    return;
  }
  if (exchange->length_known && exchange->length > config->upload_bytes) {
    refuse_size(exchange);
    return;
  }
  if (!change_allowed(exchange, id))
    return;
  struct lod_jobs_counts counts = lod_jobs_counts(exchange->service->jobs);
  if (counts.queued - counts.queued_later >= config->bake_queue) {
    lod_reply_problem(reply, 503, "queue-full", "Too many bakes are waiting; try again later.", "");
    lod_reply_header(reply, "Retry-After", "10");
    return;
  }
  if (exchange->length_known && !take_share(exchange, exchange->length))
    return;
  struct lod_query_problem problem = {0};
  struct upload *upload = calloc(1, sizeof *upload);
  enum lod_status status = upload ? LOD_OK : lod_fail_memory(&problem.problem);
  if (upload) {
    upload->fd = -1;
    exchange->state = upload;
    exchange->state_finish = upload_finish;
    status = lod_jobs_upload_create(exchange->service->jobs, &upload->fd, &problem.problem);
  }
  if (status != LOD_OK) {
    lod_reply_failure(reply, &problem);
    return;
  }
  choose_name(exchange, upload);
  snprintf(upload->format, sizeof upload->format, "%s", format ? format : "");
}

void lod_body_upload(struct lod_exchange *exchange, const char *bytes, size_t size) {
  enum { FLUSH_BYTES = 8 << 20 };
  struct upload *upload = exchange->state;
  lod_metrics_add(exchange->service->metrics, LOD_METRIC_BODY_BYTES_RECEIVED, (int64_t)size);
  if (upload->size + size > exchange->service->config->upload_bytes) {
    refuse_size(exchange);
    return;
  }
  if (!exchange->length_known && !take_share(exchange, size))
    return;
  while (size) {
    ssize_t written = write(upload->fd, bytes, size);
    if (written < 0 && errno == EINTR)
      continue;
    if (written <= 0) {
      bool full = written == 0 || errno == ENOSPC || errno == EDQUOT, locked = errno == EROFS;
      lod_reply_problem(&exchange->reply,
                        full     ? 507
                        : locked ? 503
                                 : 500,
                        full     ? "disk-full"
                        : locked ? "store-read-only"
                                 : "disk-error",
                        "The server could not write the upload to its disk.", "");
      return;
    }
    bytes += written;
    size -= (size_t)written;
    upload->size += (uint64_t)written;
  }
  /* Begin to write pages out while the rest arrives, so that the sync before the job is acknowledged is short. */
  if (upload->size - upload->flushed >= FLUSH_BYTES) {
    sync_file_range(upload->fd, (off_t)upload->flushed, (off_t)(upload->size - upload->flushed), SYNC_FILE_RANGE_WRITE);
    upload->flushed = upload->size;
  }
}

static void submit_upload(struct lod_exchange *exchange) {
  struct upload *upload = exchange->state;
  const char *id = exchange->target.segments[2];
  struct lod_query_problem problem = {0};
  uint64_t job = 0;
  int fd = upload->fd;
  upload->fd = -1;
  char *name = lod_utf8_copy(upload->name);
  enum lod_status status;
  if (name) {
    status = lod_jobs_submit(exchange->service->jobs, id, name, *upload->format ? upload->format : NULL, fd, &job, &problem.problem);
  } else {
    close(fd);
    status = lod_fail_memory(&problem.problem);
  }
  free(name);
  if (status != LOD_OK) {
    lod_reply_failure(&exchange->reply, &problem);
    return;
  }
  json_t *answer = json_pack("{s:I, s:s}", "job", (json_int_t)job, "id", id);
  lod_reply_json(&exchange->reply, 202, LOD_CACHE_NO_STORE, answer ? json_dumps(answer, JSON_COMPACT) : NULL);
  json_decref(answer);
  lod_reply_header(&exchange->reply, "Location", "/v1/jobs/%llu", (unsigned long long)job);
}

void lod_answer_upload(struct lod_exchange *exchange) {
  struct upload *upload = exchange->state;
  if (upload->size == 0)
    lod_reply_problem(&exchange->reply, 400, "empty-body", "The body is empty; it must be the model's file.", "");
  else
    exchange->work = submit_upload;
}

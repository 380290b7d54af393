/* The warm worker's loop. */
#include <jansson.h>
#include <malloc.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/jobs/frame.h"
#include "server/worker/refine.h"

enum { KEPT_BASES = 4, MAX_PARAMETERS = 32, BASE_MAX_BYTES = 1 << 30 };

struct kept {
  char name[65];
  struct lod_refine_base *base;
  uint64_t used;
};

struct serving {
  struct lod_frame_reader reader;
  uint64_t memory_bytes, requests;
  struct kept kept[KEPT_BASES];
  bool stop; /* the request at hand was cancelled while its base or values came */
  bool gone; /* the socket ended, or what came over it is no sense */
};

static bool send_frames(char type, const void *bytes, size_t size) {
  for (size_t at = 0; at < size;) {
    size_t piece = size - at < LOD_FRAME_MAX ? size - at : LOD_FRAME_MAX;
    if (lod_frame_write(LOD_WORKER_SOCKET_FD, type, (const char *)bytes + at, piece) != LOD_OK)
      return false;
    at += piece;
  }
  return true;
}

static bool send_json(char type, json_t *json) {
  char *text = json == NULL ? NULL : json_dumps(json, JSON_COMPACT | JSON_REAL_PRECISION(17));
  json_decref(json);
  bool sent = text != NULL && send_frames(type, text, strlen(text));
  free(text);
  return sent;
}

static bool send_problem(const struct lod_problem *problem, const char *parameter) {
  json_t *detail = json_string(problem->detail);
  if (detail == NULL)
    detail = json_string("The request is wrong in a way whose description is not UTF-8.");
  return send_json('F', json_pack("{sssssoss}", "status", lod_status_name(problem->status), "type", problem->type, "detail", detail,
                                  "parameter", parameter));
}

/* Blocks for a frame; false when the socket ended. */
static bool next_frame(struct serving *s, char *type) {
  s->gone = s->gone || lod_frame_read(LOD_WORKER_SOCKET_FD, &s->reader, type) != LOD_OK;
  return !s->gone;
}

/* Anything that arrives while a request is worked on tells to stop. */
static bool told_to_stop(void *context) {
  const struct serving *s = context;
  struct pollfd fd = {LOD_WORKER_SOCKET_FD, POLLIN, 0};
  return s->stop || poll(&fd, 1, 0) > 0;
}

/* The next request of many comes within this once an answer is out; waiting for it costs nobody anything. */
static bool nobody_asks(void) {
  struct pollfd fd = {LOD_WORKER_SOCKET_FD, POLLIN, 0};
  return poll(&fd, 1, 3) == 0;
}

/* Bytes that follow in frames of one type; NULL: memory, or something else came. The daemon may have said to stop before it saw that they
 * were asked for: it sends them all the same, so they are taken, and serve the next request. */
static uint8_t *receive(struct serving *s, char type, size_t size) {
  uint8_t *bytes = malloc(size + 1);
  for (size_t at = 0; bytes != NULL && at < size;) {
    char got;
    const bool came = next_frame(s, &got);
    if (came && got == 'X') {
      s->stop = true;
      continue;
    }
    if (!came || got != type || s->reader.payload_size > size - at || s->reader.payload_size == 0) {
      s->gone = true;
      free(bytes);
      return NULL;
    }
    memcpy(bytes + at, s->reader.payload, s->reader.payload_size);
    at += s->reader.payload_size;
  }
  return bytes;
}

/* ---- bases ---- */

static enum lod_status fetch_base(struct serving *s, struct kept *place, const char *name, size_t size, struct lod_problem *problem) {
  lod_refine_base_destroy(place->base);
  *place = (struct kept){0};
  if (!send_json('N', json_object())) {
    s->gone = true;
    return lod_fail(problem, LOD_IO, "daemon-gone", "The daemon is gone.");
  }
  uint8_t *bytes = receive(s, 'B', size);
  if (bytes == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = lod_refine_base_create("base", bytes, size, s->memory_bytes / 2, &place->base, problem);
  if (status == LOD_OK)
    snprintf(place->name, sizeof place->name, "%s", name);
  free(bytes);
  return status;
}

static enum lod_status find_base(struct serving *s, const char *name, size_t size, struct lod_refine_base **base,
                                 struct lod_problem *problem) {
  struct kept *oldest = &s->kept[0];
  for (int i = 0; i < KEPT_BASES; i++) {
    struct kept *kept = &s->kept[i];
    if (kept->base != NULL && strcmp(kept->name, name) == 0) {
      kept->used = s->requests;
      *base = kept->base;
      return LOD_OK;
    }
    if (kept->used < oldest->used)
      oldest = kept;
  }
  LOD_TRY(fetch_base(s, oldest, name, size, problem));
  oldest->used = s->requests;
  *base = oldest->base;
  return LOD_OK;
}

static void forget_others(struct serving *s, const struct lod_refine_base *but) {
  for (int i = 0; i < KEPT_BASES; i++)
    if (s->kept[i].base != NULL && s->kept[i].base != but) {
      lod_refine_base_destroy(s->kept[i].base);
      s->kept[i] = (struct kept){0};
    }
}

/* ---- requests ---- */

struct asked {
  json_t *json;
  const char *kind, *base;
  size_t base_bytes, values_bytes;
  uint64_t max_triangles;
  struct lod_refine_query query;
  uint8_t *values;
};

static uint64_t count_of(const json_t *json, const char *name) {
  json_int_t value = json_integer_value(json_object_get(json, name));
  return value > 0 ? (uint64_t)value : 0;
}

static enum lod_status read_query(struct asked *asked, char *parameter, struct lod_problem *problem) {
  struct lod_refine_parameter list[MAX_PARAMETERS];
  uint32_t count = 0;
  const char *key;
  json_t *value;
  json_object_foreach(json_object_get(asked->json, "parameters"), key, value) {
    if (count == MAX_PARAMETERS || !json_is_string(value))
      return lod_fail(problem, LOD_BAD_INPUT, "bad-parameter", "Too many parameters.");
    list[count++] = (struct lod_refine_parameter){key, json_string_value(value)};
  }
  return lod_refine_query_parse(list, count, asked->values_bytes != 0, &asked->query, parameter, problem);
}

static bool answer_contact(struct lod_refine_base *base, struct asked *asked, struct lod_problem *problem, bool *sent) {
  struct lod_contact contact;
  if (lod_refine_touch(base, &asked->query, &contact, problem) != LOD_OK)
    return false;
  *sent = send_json('R', json_pack("{sis[fff]s[fff]sfsi}", "bytes", 0, "point", contact.point[0], contact.point[1], contact.point[2],
                                   "normal", contact.normal[0], contact.normal[1], contact.normal[2], "distance", contact.distance, "steps",
                                   (int)asked->query.steps));
  return true;
}

static bool answer_refine(struct serving *s, struct lod_refine_base *base, struct asked *asked, char *parameter,
                          struct lod_problem *problem, bool *sent) {
  struct lod_progress progress = {.cancelled = told_to_stop, .context = s};
  struct lod_refine_request request = {.query = &asked->query,
                                       .values = (const float *)(const void *)asked->values,
                                       .value_count = asked->values_bytes / sizeof(float),
                                       .max_triangles = asked->max_triangles,
                                       .progress = &progress};
  struct lod_refine_answer answer;
  enum lod_status status = lod_refine_answer(base, &request, &answer, parameter, problem);
  if (status == LOD_MEMORY) { /* other bases may be in the way */
    forget_others(s, base);
    *problem = (struct lod_problem){0};
    status = lod_refine_answer(base, &request, &answer, parameter, problem);
  }
  if (status != LOD_OK)
    return false;
  *sent = send_json('R', json_pack("{sIsIsIsIsisb}", "bytes", (json_int_t)answer.size, "triangles", (json_int_t)answer.triangles,
                                   "vertices", (json_int_t)answer.vertices, "base_triangles", (json_int_t)answer.base_triangles, "deepest",
                                   (int)answer.deepest, "budget", (int)answer.budget)) &&
          send_frames('G', answer.bytes, answer.size);
  return true;
}

/* False when the worker is to end. */
static bool answer(struct serving *s) {
  struct asked asked = {.json = json_loadb(s->reader.payload, s->reader.payload_size, JSON_REJECT_DUPLICATES, NULL)};
  struct lod_problem problem = {0};
  char parameter[LOD_REFINE_QUERY_PARAMETER + 1] = "";
  bool sent = false, answered = false;
  asked.kind = json_string_value(json_object_get(asked.json, "kind"));
  asked.base = json_string_value(json_object_get(asked.json, "base"));
  asked.base_bytes = count_of(asked.json, "base_bytes");
  asked.values_bytes = count_of(asked.json, "values_bytes");
  asked.max_triangles = count_of(asked.json, "max_triangles");
  s->requests++;
  s->stop = false;
  if (asked.kind == NULL || asked.base == NULL || asked.base_bytes > BASE_MAX_BYTES || asked.values_bytes > BASE_MAX_BYTES) {
    json_decref(asked.json);
    return false;
  }
  struct lod_refine_base *base = NULL;
  enum lod_status status = LOD_OK;
  if (asked.values_bytes != 0 && (asked.values = receive(s, 'V', asked.values_bytes)) == NULL)
    status = lod_fail_memory(&problem);
  if (status == LOD_OK)
    status = read_query(&asked, parameter, &problem);
  if (status == LOD_OK)
    status = find_base(s, asked.base, asked.base_bytes, &base, &problem);
  if (status == LOD_OK)
    answered = strcmp(asked.kind, "contact") == 0 ? answer_contact(base, &asked, &problem, &sent)
                                                  : answer_refine(s, base, &asked, parameter, &problem, &sent);
  if (!answered)
    sent = send_problem(&problem, parameter);
  if (base != NULL && sent)
    lod_refine_base_tidy(base, nobody_asks());
  free(asked.values);
  json_decref(asked.json);
  return sent;
}

int lod_refine_serve(const char *first) {
  struct serving s = {0};
  json_t *job = json_loads(first, 0, NULL);
  s.memory_bytes = count_of(job, "memory_bytes");
  json_decref(job);
  /* Memory that one answer took serves the next: to map it anew costs more than to fill it. */
  mallopt(M_MMAP_MAX, 0);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  mallopt(M_TOP_PAD, 16 << 20);
  char type;
  while (next_frame(&s, &type))
    if (type != 'X' && (type != 'Q' || !answer(&s)))
      break;
  for (int i = 0; i < KEPT_BASES; i++)
    lod_refine_base_destroy(s.kept[i].base);
  lod_frame_reader_finish(&s.reader);
  return 0;
}

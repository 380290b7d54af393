/* Requests and replies: between libmicrohttpd and the routes. */
#include <dlfcn.h>
#include <gnutls/gnutls.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/loop.h"
#include "server/http/memo.h"
#include "server/log.h"

enum {
  STREAM_BYTES = 4 << 10,
  IGNORED_BODY_MAX = 1 << 20,
  RESPONSE_HEADERS = 32,
  HEADER_TEXT_MAX = 4096,
};

/* ---- what libmicrohttpd says by itself ---- */

typedef enum MHD_Result queue_function(struct MHD_Connection *, unsigned, struct MHD_Response *);

/* The next definition after ours in the order of symbols is the library's. */
static queue_function *queue_response(void) {
  static _Atomic(queue_function *) next;
  queue_function *found = next;
  if (!found) {
    *(void **)&found = dlsym(RTLD_NEXT, "MHD_queue_response");
    next = found;
  }
  return found;
}

/* ---- responses ---- */

struct headers {
  struct {
    const char *name, *value;
  } list[RESPONSE_HEADERS];
  uint32_t count;
  char text[HEADER_TEXT_MAX]; /* all of them: what makes two responses of the same body the same */
  size_t size;
};

static void emit_header(void *context, const char *name, const char *value) {
  struct headers *headers = context;
  if (headers->count == RESPONSE_HEADERS)
    return;
  headers->list[headers->count].name = name;
  headers->list[headers->count++].value = value;
  size_t name_size = strlen(name) + 1, value_size = strlen(value) + 1;
  if (name_size + value_size <= sizeof headers->text - headers->size) {
    memcpy(headers->text + headers->size, name, name_size);
    memcpy(headers->text + headers->size + name_size, value, value_size);
    headers->size += name_size + value_size;
  }
}

static void release_body(void *body) {
  lod_body_release(body);
}
static ssize_t read_stream(void *context, uint64_t position, char *buffer, size_t size) {
  struct connection *connection = context;
  struct lod_stream *stream = &connection->exchange.reply.stream;
  (void)position;
  if (connection->gone)
    return MHD_CONTENT_READER_END_WITH_ERROR;
  ssize_t count = stream->read(stream->context, buffer, size);
  if (count < 0)
    return MHD_CONTENT_READER_END_OF_STREAM;
  if (count == 0) { /* an answer of 0 would be asked again at once */
    connection->waiting = true;
    MHD_suspend_connection(connection->mhd);
  }
  return count;
}

/* A response with these headers over a part of the body; the body is retained. NULL: memory. */
static struct MHD_Response *make_response(struct connection *connection, const struct headers *headers, uint64_t first, uint64_t size) {
  const struct lod_reply *reply = &connection->exchange.reply;
  struct MHD_Response *response;
  if (reply->stream.read)
    response = MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, STREAM_BYTES, read_stream, connection, NULL);
  else if (reply->body && size)
    response = MHD_create_response_from_buffer_with_free_callback_cls((size_t)size, (void *)(reply->body->bytes + first), release_body,
                                                                      lod_body_retain(reply->body));
  else
    response = MHD_create_response_from_buffer(0, NULL, MHD_RESPMEM_PERSISTENT);
  for (uint32_t i = 0; response && i < headers->count; i++)
    if (MHD_add_response_header(response, headers->list[i].name, headers->list[i].value) != MHD_YES) {
      MHD_destroy_response(response);
      response = NULL;
    }
  return response;
}

static void enter_send(struct connection *connection) {
  const struct lod_body *body = connection->exchange.reply.body;
  lod_deadline_enter(&connection->deadline, LOD_PHASE_SEND, connection->loop->now);
  lod_loop_set_bulk(connection, body && body->file >= 0 && connection->sent >= LOD_OBJECT_FILE_BYTES);
}

/* A shared response cannot name the request; its id goes in on the way to the socket, and what else is of this reply alone. */
static void insert_own(struct connection *connection) {
  const struct lod_reply *reply = &connection->exchange.reply;
  struct lod_insert *insert = &connection->sending.insert;
  connection->sending.body_follows = connection->sent > 0;
  lod_insert_begin(insert, "X-Request-Id", connection->request_id);
  if (reply->own_name) {
    char milliseconds[32];
    lod_insert_more(insert, reply->own_name, reply->own_value);
    snprintf(milliseconds, sizeof milliseconds, "app;dur=%.3f", 1e3 * (lod_loop_clock() - connection->started));
    lod_insert_more(insert, "Server-Timing", milliseconds);
  }
}

static enum MHD_Result queue_whole(struct connection *connection, unsigned status, const struct headers *headers) {
  struct lod_http *http = connection->loop->http;
  const struct lod_exchange *exchange = &connection->exchange;
  const struct lod_reply *reply = &exchange->reply;
  uint64_t size = reply->body ? reply->body->size : 0;
  if (!reply->shared || headers->size + 256 > HEADER_TEXT_MAX) {
    struct MHD_Response *response = make_response(connection, headers, 0, size);
    enum MHD_Result result = response ? queue_response()(connection->mhd, status, response) : MHD_NO;
    if (response)
      MHD_destroy_response(response);
    return result;
  }
  uint64_t generation = lod_store_generation(http->service->store);
  struct lod_cache_entry *entry = lod_cache_find(http->responses, headers->text, headers->size, generation);
  if (!entry) {
    struct MHD_Response *response = make_response(connection, headers, 0, size);
    entry = response ? lod_cache_insert(http->responses, headers->text, headers->size, generation, response) : NULL;
  }
  if (!entry)
    return MHD_NO;
  enum MHD_Result result = queue_response()(connection->mhd, status, lod_cache_value(entry));
  if (reply->own_name)
    lod_cache_release(http->responses, entry);
  else
    lod_memo_insert(http->memos, exchange, connection->target, generation, http->responses, entry);
  return result;
}

/* The reply that the same target had before, under the conditions of this request. */
static enum MHD_Result queue_memo(struct connection *connection) {
  struct lod_exchange *exchange = &connection->exchange;
  const struct lod_memo *memo = lod_cache_value(connection->memo);
  struct lod_conditions conditions = lod_exchange_conditions(exchange);
  struct lod_plan plan = lod_conditions_plan(&conditions, memo->etag, memo->body->size);
  if (plan.status != 200 && plan.status != 304)
    return MHD_NO; /* lod_memo_find leaves such requests alone */
  if (plan.status == 304)
    lod_metrics_add(exchange->service->metrics, LOD_METRIC_NOT_MODIFIED, 1);
  connection->status = plan.status;
  connection->sent = plan.status == 304 || exchange->method == LOD_HEAD ? 0 : memo->body->size;
  enter_send(connection);
  insert_own(connection);
  return queue_response()(connection->mhd, plan.status, lod_cache_value(memo->response));
}

/* Puts conditions and ranges into effect and hands the reply to MHD. */
static enum MHD_Result queue_reply(struct connection *connection) {
  struct lod_exchange *exchange = &connection->exchange;
  struct lod_reply *reply = &exchange->reply;
  struct lod_metrics *metrics = exchange->service->metrics;
  struct lod_plan plan = {.status = reply->status, .size = reply->body ? reply->body->size : 0};
  if (reply->status == 200 && reply->body) {
    struct lod_conditions conditions = lod_exchange_conditions(exchange);
    plan = lod_conditions_plan(&conditions, reply->etag, reply->body->size);
    if (plan.status == 416) {
      uint64_t size = reply->body->size;
      lod_reply_problem(reply, 416, "range-not-satisfiable", "The range is malformed or lies outside of the representation.", "");
      lod_reply_header(reply, "Content-Range", "bytes */%llu", (unsigned long long)size);
    } else if (plan.status == 412) {
      lod_reply_problem(reply, 412, "precondition-failed", "If-Match does not name the present representation.", "");
    } else if (plan.status == 206) {
      lod_reply_header(reply, "Content-Range", "bytes %llu-%llu/%llu", (unsigned long long)plan.first,
                       (unsigned long long)(plan.first + plan.size - 1), (unsigned long long)reply->body->size);
      lod_metrics_add(metrics, LOD_METRIC_PARTIAL, 1);
    } else if (plan.status == 304) {
      lod_metrics_add(metrics, LOD_METRIC_NOT_MODIFIED, 1);
    }
  }
  if (!reply->shared && !reply->stream.read)
    lod_reply_header(reply, "Server-Timing", "app;dur=%.3f", 1e3 * (lod_loop_clock() - connection->started));
  struct headers headers;
  headers.count = 0;
  headers.size = 0;
  lod_routes_headers(exchange, emit_header, &headers);
  connection->status = plan.status;
  bool bodiless = plan.status == 304 || exchange->method == LOD_HEAD;
  connection->sent = bodiless ? 0 : plan.status == 206 ? plan.size : reply->body ? reply->body->size : 0;
  enter_send(connection);
  if (reply->shared)
    insert_own(connection);
  if (reply->stream.read)
    lod_loop_add_stream(connection);
  /* 304 is the whole response under another status: from an empty one MHD would send Content-Length: 0. */
  if (plan.status != 206)
    return queue_whole(connection, plan.status, &headers);
  struct MHD_Response *response = make_response(connection, &headers, plan.first, plan.size);
  enum MHD_Result result = response ? queue_response()(connection->mhd, 206, response) : MHD_NO;
  if (response)
    MHD_destroy_response(response);
  return result;
}

/* Sends an error while a body still arrives, where MHD takes no response any more, and has the connection closed. */
static enum MHD_Result last_word(struct connection *connection, const struct lod_exchange *exchange) {
  const struct lod_reply *reply = &exchange->reply;
  struct headers headers;
  headers.count = 0;
  headers.size = 0;
  char text[HEADER_TEXT_MAX + 2048];
  lod_routes_headers(exchange, emit_header, &headers);
  size_t body_size = reply->body ? reply->body->size : 0;
  int size = snprintf(text, sizeof text, "HTTP/1.1 %u %s\r\nConnection: close\r\nContent-Length: %zu\r\n", reply->status,
                      MHD_get_reason_phrase_for(reply->status), body_size);
  for (uint32_t i = 0; i < headers.count && (size_t)size < sizeof text; i++)
    size += snprintf(text + size, sizeof text - (size_t)size, "%s: %s\r\n", headers.list[i].name, headers.list[i].value);
  if ((size_t)size + 2 + body_size <= sizeof text) {
    memcpy(text + size, "\r\n", 2);
    if (body_size)
      memcpy(text + size + 2, reply->body->bytes, body_size);
    size_t total = (size_t)size + 2 + body_size;
    const union MHD_ConnectionInfo *tls = MHD_get_connection_info(connection->mhd, MHD_CONNECTION_INFO_GNUTLS_SESSION);
    ssize_t ignored = tls && tls->tls_session ? gnutls_record_send(tls->tls_session, text, total)
                                              : send(connection->fd, text, total, MSG_NOSIGNAL | MSG_DONTWAIT);
    (void)ignored; /* the connection ends either way */
  }
  connection->status = reply->status;
  connection->sent = body_size;
  connection->linger = true;
  return MHD_NO;
}

static const char *no_header(void *context, const char *name) {
  (void)context, (void)name;
  return NULL;
}

static const char *problem_of(unsigned status, const char **type) {
  static const struct {
    unsigned status;
    const char *type, *detail;
  } kProblems[] = {
      {400, "bad-request", "This is not a request of HTTP/1.1 as RFC 9112 has it; among others, the Host header must be there."},
      {413, "upload-too-large", "The body is larger than this server takes."},
      {414, "uri-too-long", "The request line is longer than this server takes."},
      {431, "headers-too-large", "The headers are longer than this server takes, 15 KiB together."},
      {0, "http-error", "The request cannot be served."},
  };
  size_t i = 0;
  while (kProblems[i].status && kProblems[i].status != status)
    i++;
  *type = kProblems[i].type;
  return kProblems[i].detail;
}

static struct connection *connection_of(struct MHD_Connection *mhd) {
  const union MHD_ConnectionInfo *info = MHD_get_connection_info(mhd, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
  return info ? info->socket_context : NULL;
}

/* libmicrohttpd calls itself by this name when it refuses what it cannot parse, with a page of HTML (and, without a Host, with its header
 * twice); the program's definition comes before its own, and our replies do not come this way. Answers and has the connection closed. */
enum MHD_Result MHD_queue_response(struct MHD_Connection *mhd, unsigned status, struct MHD_Response *response) {
  struct connection *connection = connection_of(mhd);
  if (!connection || status < 400)
    return queue_response()(mhd, status, response);
  struct lod_exchange exchange = {.service = connection->loop->http->service, .method = LOD_GET, .header = no_header};
  const char *type, *detail = problem_of(status, &type);
  lod_reply_problem(&exchange.reply, status, type, detail, "");
  enum MHD_Result result = last_word(connection, &exchange);
  lod_reply_finish(&exchange.reply);
  return result;
}

/* ---- requests ---- */

static const char *look_up_header(void *context, const char *name) {
  return MHD_lookup_connection_value(context, MHD_HEADER_KIND, name);
}

static enum lod_method parse_method(const char *text) {
  static const char *const kNames[] = {"GET", "HEAD", "PUT", "DELETE", "POST", "OPTIONS"};
  for (int i = 0; i < LOD_METHOD_OTHER; i++)
    if (strcmp(text, kNames[i]) == 0)
      return (enum lod_method)i;
  return LOD_METHOD_OTHER;
}

/* The request line was read: a request begins. Its result is the handler's *request_context. */
void *lod_request_begin(void *context, const char *uri, struct MHD_Connection *mhd) {
  struct connection *connection = connection_of(mhd);
  size_t size = strlen(uri) + 1;
  (void)context;
  if (!connection)
    return NULL;
  if (size > connection->target_capacity) {
    char *both = realloc(connection->target, 2 * size);
    if (!both)
      return NULL;
    connection->target = both;
    connection->target_capacity = size;
  }
  connection->parsed = connection->target + connection->target_capacity;
  memcpy(connection->target, uri, size);
  memcpy(connection->parsed, uri, size);
  connection->active = true;
  connection->begun = connection->answered = connection->working = connection->work_done = connection->waiting = connection->gone = false;
  connection->ignored = connection->sent = 0;
  connection->status = 0;
  strcpy(connection->method, "?");
  *connection->request_id = 0;
  memset(&connection->exchange, 0, offsetof(struct lod_exchange, reply.headers));
  connection->started = lod_loop_clock();
  lod_deadline_enter(&connection->deadline, LOD_PHASE_HEADERS, connection->loop->now);
  return connection;
}

static enum MHD_Result begin_exchange(struct connection *connection, const char *method) {
  struct lod_exchange *exchange = &connection->exchange;
  struct lod_http *http = connection->loop->http;
  connection->begun = true;
  snprintf(connection->method, sizeof connection->method, "%s", method);
  exchange->service = http->service;
  exchange->method = parse_method(method);
  exchange->header = look_up_header;
  exchange->header_context = connection->mhd;
  const char *length = look_up_header(connection->mhd, "Content-Length");
  exchange->length_known = length != NULL;
  exchange->length = length ? strtoull(length, NULL, 10) : 0;
  bool has_body = exchange->length > 0 || look_up_header(connection->mhd, "Transfer-Encoding");
  lod_request_id(look_up_header(connection->mhd, "X-Request-Id"), connection->request_id);
  exchange->request_id = connection->request_id;
  connection->memo = has_body ? NULL : lod_memo_find(http->memos, exchange, connection->target, lod_store_generation(http->service->store));
  if (connection->memo) {
    const struct lod_memo *memo = lod_cache_value(connection->memo);
    exchange->route = memo->route;
    exchange->reply.body = lod_body_retain(memo->body);
    lod_deadline_enter(&connection->deadline, LOD_PHASE_WORK, connection->loop->now);
    return MHD_YES;
  }
  struct lod_query_problem problem = {0};
  if (lod_target_parse(connection->parsed, &exchange->target, &problem) != LOD_OK)
    lod_reply_failure(&exchange->reply, &problem);
  else
    lod_routes_begin(exchange);
  if (exchange->reply.status && has_body) { /* refused before the body: MHD closes after it, and skips "100 Continue" */
    connection->linger = true;
    return queue_reply(connection);
  }
  lod_deadline_enter(&connection->deadline, has_body ? LOD_PHASE_RECEIVE : LOD_PHASE_WORK, connection->loop->now);
  return MHD_YES; /* a reply in this first call would close the connection */
}

static enum MHD_Result take_body(struct connection *connection, const char *bytes, size_t size) {
  struct lod_exchange *exchange = &connection->exchange;
  if (exchange->route && exchange->route->body && !exchange->reply.status) {
    exchange->route->body(exchange, bytes, size);
    return exchange->reply.status ? last_word(connection, exchange) : MHD_YES;
  }
  connection->ignored += size;
  return connection->ignored > IGNORED_BODY_MAX ? MHD_NO : MHD_YES;
}

/* Any thread: the reply of a suspended connection is there. */
static void hand_back(struct connection *connection) {
  struct loop *loop = connection->loop;
  pthread_mutex_lock(&loop->lock);
  connection->next_done = loop->done;
  loop->done = connection;
  pthread_mutex_unlock(&loop->lock);
  lod_loop_wake(loop);
}

static void finish_later(struct lod_exchange *exchange) {
  hand_back((struct connection *)((char *)exchange - offsetof(struct connection, exchange)));
}

static void run_work(struct lod_background_work *work) {
  struct connection *connection = (struct connection *)((char *)work - offsetof(struct connection, work));
  if (connection->exchange.start) {
    if (connection->exchange.start(&connection->exchange))
      return; /* the connection may be at its next request by now */
  } else {
    connection->exchange.work(&connection->exchange);
    lod_exchange_compress(&connection->exchange, true);
  }
  hand_back(connection);
}

static enum MHD_Result answer(struct connection *connection) {
  struct lod_exchange *exchange = &connection->exchange;
  if (connection->memo)
    return queue_memo(connection);
  if (!connection->answered) {
    connection->answered = true;
    lod_deadline_enter(&connection->deadline, LOD_PHASE_WORK, connection->loop->now);
    if (!exchange->reply.status)
      exchange->route->answer(exchange);
  }
  if (!exchange->work && !connection->work_done)
    lod_exchange_compress(exchange, false);
  if (exchange->work || exchange->start) {
    exchange->finished = finish_later;
    if (exchange->cancel && !connection->streaming)
      lod_loop_add_stream(connection); /* so that its peer is watched */
    connection->work.run = run_work;
    connection->working = true;
    MHD_suspend_connection(connection->mhd);
    if (lod_background_add(connection->loop->http->background, &connection->work))
      return MHD_YES;
    connection->working = false;
    MHD_resume_connection(connection->mhd);
    exchange->work = NULL;
    exchange->start = NULL;
    lod_reply_problem(&exchange->reply, 503, "overloaded", "Too many requests wait for the disk; try again later.", "");
    lod_reply_header(&exchange->reply, "Retry-After", "1");
  }
  return queue_reply(connection);
}

enum MHD_Result lod_request_handle(void *context, struct MHD_Connection *mhd, const char *url, const char *method, const char *version,
                                   const char *bytes, size_t *size, void **request_context) {
  struct connection *connection = *request_context;
  (void)context, (void)mhd, (void)url, (void)version;
  if (!connection)
    return MHD_NO; /* no memory at the request line */
  if (!connection->begun)
    return begin_exchange(connection, method);
  if (*size) {
    enum MHD_Result result = take_body(connection, bytes, *size);
    *size = 0;
    return result;
  }
  return answer(connection);
}

void lod_request_end(void *context, struct MHD_Connection *mhd, void **request_context, enum MHD_RequestTerminationCode code) {
  static const char *const kNotes[] = {NULL, "connection failed", "timeout", "server stopped", "peer stopped sending", "peer went away"};
  struct connection *connection = *request_context;
  (void)context, (void)mhd;
  if (!connection || !connection->active)
    return;
  struct lod_exchange *exchange = &connection->exchange;
  struct lod_service *service = connection->loop->http->service;
  double seconds = lod_loop_clock() - connection->started;
  bool whole = code == MHD_REQUEST_TERMINATED_COMPLETED_OK;
  const char *note = connection->cut                                 ? lod_cut_name(connection->cut)
                     : (size_t)code < sizeof kNotes / sizeof *kNotes ? kNotes[code]
                                                                     : "failed";
  if (connection->status == 0 && !connection->begun)
    note = note ? note : "refused by the HTTP parser";
  else if (connection->gone || connection->status >= 400 || exchange->reply.stream.read)
    note = NULL; /* a stream's end and a refused upload are no accident */
  if (whole && connection->sent)
    lod_metrics_add(service->metrics, LOD_METRIC_BODY_BYTES_SENT, (int64_t)connection->sent);
  lod_metrics_request(service->metrics, lod_route_index(exchange->route), connection->status, seconds);
  if (exchange->route && exchange->route->protected && lod_log_enabled(LOD_LOG_INFO)) {
    char peer[LOD_ADDRESS_TEXT_MAX];
    struct lod_log_audit audit = {connection->method,
                                  exchange->target.segments[2],
                                  exchange->token ? lod_token_name(exchange->token) : "",
                                  lod_loop_peer(connection, peer),
                                  connection->request_id,
                                  connection->status};
    lod_log_write_audit(&audit);
  }
  if (lod_log_enabled(note ? LOD_LOG_WARN : LOD_LOG_INFO)) {
    char peer[LOD_ADDRESS_TEXT_MAX];
    struct lod_log_request line = {connection->method,
                                   connection->target,
                                   lod_loop_peer(connection, peer),
                                   connection->request_id,
                                   connection->status,
                                   connection->sent,
                                   seconds,
                                   note};
    lod_log_write_request(&line);
  }
  lod_loop_forget_stream(connection);
  if (connection->memo)
    lod_cache_release(connection->loop->http->memos, connection->memo);
  connection->memo = NULL;
  lod_reply_finish(&exchange->reply);
  if (exchange->state_finish)
    exchange->state_finish(exchange->state);
  exchange->state_finish = NULL;
  connection->active = connection->waiting = false;
  *request_context = NULL;
  lod_deadline_enter(&connection->deadline, LOD_PHASE_WAIT, connection->loop->now);
}

#include "server/log.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static struct {
  bool json;
  _Atomic enum lod_log_level level;
} settings = {false, LOD_LOG_INFO};

static const char *const kNames[] = {"debug", "info", "warn", "error", "off"};

void lod_log_open(bool json, enum lod_log_level level) {
  settings.json = json;
  settings.level = level;
}

bool lod_log_level_parse(const char *name, enum lod_log_level *level) {
  for (int i = 0; i <= LOD_LOG_OFF; i++)
    if (strcmp(name, kNames[i]) == 0) {
      *level = (enum lod_log_level)i;
      return true;
    }
  return false;
}

void lod_log_set_level(enum lod_log_level level) {
  settings.level = level;
}

bool lod_log_enabled(enum lod_log_level level) {
  return level >= settings.level && level != LOD_LOG_OFF;
}

/* A line in the making; what does not fit is cut, the newline always fits. */
struct line {
  char text[2048];
  size_t size;
};

__attribute__((format(printf, 2, 3))) static void add(struct line *line, const char *format, ...) {
  size_t room = sizeof line->text - 4 - line->size;
  va_list arguments;
  va_start(arguments, format);
  int length = vsnprintf(line->text + line->size, room, format, arguments);
  va_end(arguments);
  if (length > 0)
    line->size += (size_t)length < room ? (size_t)length : room - 1;
}

/* Text in quotes, safe in JSON and on a terminal: control characters, quotes, backslashes and everything outside ASCII are escaped. */
static void add_quoted(struct line *line, const char *text) {
  add(line, "\"");
  for (const unsigned char *p = (const unsigned char *)text; *p && line->size < sizeof line->text - 16; p++) {
    if (*p == '"' || *p == '\\')
      add(line, "\\%c", *p);
    else if (*p < 0x20 || *p >= 0x7f)
      add(line, "\\u%04x", *p);
    else
      line->text[line->size++] = (char)*p;
  }
  add(line, "\"");
}

static void begin(struct line *line, enum lod_log_level level) {
  struct timespec now;
  struct tm utc;
  char stamp[32];
  line->size = 0;
  clock_gettime(CLOCK_REALTIME, &now);
  gmtime_r(&now.tv_sec, &utc);
  strftime(stamp, sizeof stamp, "%Y-%m-%dT%H:%M:%S", &utc);
  add(line, settings.json ? "{\"time\":\"%s.%03ldZ\",\"level\":\"%s\"" : "%s.%03ldZ %-5s", stamp, now.tv_nsec / 1000000, kNames[level]);
}

static void end(struct line *line) {
  if (settings.json)
    line->text[line->size++] = '}';
  line->text[line->size++] = '\n';
  ssize_t ignored = write(STDERR_FILENO, line->text, line->size);
  (void)ignored; /* nobody to tell */
}

void lod_log(enum lod_log_level level, const char *format, ...) {
  if (!lod_log_enabled(level))
    return;
  char message[1024];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(message, sizeof message, format, arguments);
  va_end(arguments);
  struct line line;
  begin(&line, level);
  if (settings.json) {
    add(&line, ",\"message\":");
    add_quoted(&line, message);
  } else {
    for (char *p = message; *p; p++)
      if ((unsigned char)*p < 0x20 || *p == 0x7f)
        *p = ' ';
    add(&line, " %s", message);
  }
  end(&line);
}

void lod_log_write_request(const struct lod_log_request *request) {
  enum lod_log_level level = request->note ? LOD_LOG_WARN : LOD_LOG_INFO;
  if (!lod_log_enabled(level))
    return;
  struct line line;
  begin(&line, level);
  if (settings.json) {
    add(&line, ",\"method\":");
    add_quoted(&line, request->method);
    add(&line, ",\"target\":");
    add_quoted(&line, request->target);
    add(&line, ",\"status\":%u,\"bytes\":%llu,\"seconds\":%.6f,\"peer\":\"%s\"", request->status, (unsigned long long)request->bytes,
        request->seconds, request->peer);
    if (request->id && *request->id)
      add(&line, ",\"request\":\"%s\"", request->id);
    if (request->note)
      add(&line, ",\"note\":\"%s\"", request->note);
  } else {
    add(&line, " %s %s ", request->peer, request->method);
    add_quoted(&line, request->target);
    add(&line, " %u %llu B %.3f ms", request->status, (unsigned long long)request->bytes, request->seconds * 1e3);
    if (request->id && *request->id)
      add(&line, " %s", request->id);
    if (request->note)
      add(&line, " (%s)", request->note);
  }
  end(&line);
}

void lod_log_write_audit(const struct lod_log_audit *audit) {
  if (!lod_log_enabled(LOD_LOG_INFO))
    return;
  struct line line;
  begin(&line, LOD_LOG_INFO);
  add(&line, settings.json ? ",\"audit\":" : " audit ");
  add_quoted(&line, audit->action);
  add(&line, settings.json ? ",\"model\":" : " model ");
  add_quoted(&line, audit->model);
  add(&line, settings.json ? ",\"token\":" : " token ");
  add_quoted(&line, audit->token);
  add(&line, settings.json ? ",\"status\":%u,\"peer\":\"%s\",\"request\":\"%s\"" : " %u %s %s", audit->status, audit->peer, audit->id);
  end(&line);
}

#include "server/config.h"

#include <errno.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum kind { TEXT, COUNT, BYTES };

/* The one table of settings. otherwise: the default as it would be typed. */
static const struct setting {
  const char *name, *value;
  enum kind kind;
  size_t offset;
  const char *otherwise;
  uint64_t minimum, maximum;
  const char *sentence;
} kSettings[] = {
#define AT(field) offsetof(struct lod_config, field)
    {"store", "DIR", TEXT, AT(store), "", 0, 0, "Where models are kept; made when it is not there. Required."},
    {"listen", "HOST:PORT", TEXT, AT(listen), "127.0.0.1:8080", 0, 0, "Address to serve on; port 0 takes a free one. [::]:8080 for IPv6."},
    {"models", "DIR", TEXT, AT(models), "", 0, 0,
     "Watched folder: files put into it are baked under their base name, and again when they change."},
    {"token-file", "FILE", TEXT, AT(token_file), "", 0, 0,
     "Tokens that PUT and DELETE need, a line each: NAME sha256:DIGEST [models=ID,...] [may=write,delete] [bytes-per-day=N]; or one token "
     "in plain text. Not set: anyone who connects may write."},
    {"tls-cert", "FILE", TEXT, AT(tls_cert), "", 0, 0, "PEM certificate chain: serve HTTPS. Needs tls-key."},
    {"tls-key", "FILE", TEXT, AT(tls_key), "", 0, 0, "PEM private key of tls-cert."},
    {"viewer", "DIR", TEXT, AT(viewer), "", 0, 0,
     "Files of the viewer page. Not set: ../web or ../share/lodestream/web beside this program."},
    {"worker", "PATH", TEXT, AT(worker), "", 0, 0, "The program that bakes. Not set: `lodestream` beside this program."},
    {"cors", "ORIGINS", TEXT, AT(cors), "*", 0, 0,
     "Origins that may read answers in a browser: *, or a list separated by blanks, or none."},
    {"log", "text|json", TEXT, AT(log), "text", 0, 0, "Form of the log lines on stderr."},
    {"log-level", "LEVEL", TEXT, AT(log_level), "info", 0, 0,
     "Least level that is logged: debug, info, warn, error or off; a request is info."},
    {"loops", "N", COUNT, AT(loops), "0", 0, 256, "Event loops, each a thread with a listener of its own; 0: one a processor."},
    {"connections", "N", COUNT, AT(connections), "4096", 4, 1000000, "Connections at once over all loops; more wait in the backlog."},
    {"address-connections", "N", COUNT, AT(address_connections), "1024", 0, 1000000,
     "Connections of one address (IPv6: of one /64 network); more are answered 503. 0: no limit, for use behind a proxy."},
    {"wait-seconds", "N", COUNT, AT(wait_seconds), "2", 1, 3600, "At the limit of connections for this long, who waits is answered 503."},
    {"header-seconds", "N", COUNT, AT(header_seconds), "10", 1, 3600,
     "From a request's first byte to the end of its headers; longer is cut."},
    {"idle-seconds", "N", COUNT, AT(idle_seconds), "60", 1, 86400, "A connection without a request is closed after this long."},
    {"rate-seconds", "N", COUNT, AT(rate_seconds), "30", 1, 3600, "The rate of bodies, both ways, is judged over this long."},
    {"rate-bytes", "N", BYTES, AT(rate_bytes), "1024", 0, UINT64_C(1) << 40,
     "Least bytes a second of a body in rate-seconds; slower is cut."},
    {"drain-seconds", "N", COUNT, AT(drain_seconds), "30", 0, 3600, "After SIGTERM, how long answers in progress may take."},
    {"cached-objects", "N", COUNT, AT(cached_objects), "1024", 1, 30000,
     "Mapped objects, and prepared responses, kept for the next request."},
    {"upload-bytes", "N", BYTES, AT(upload_bytes), "1GiB", 1, UINT64_C(1) << 40, "Largest model that PUT takes."},
    {"store-bytes", "N", BYTES, AT(store_bytes), "0", 0, UINT64_C(1) << 50,
     "Most that all objects may hold; a bake over it fails; 0: no limit."},
    {"families", "NAMES", TEXT, AT(families), "cluster", 0, 0, "Families that a model is first served with, separated by commas."},
    {"later-families", "NAMES", TEXT, AT(later_families), "envelope", 0, 0,
     "Families that a second bake adds once the model is served; \"\" for none."},
    {"envelope", "KEY=VALUE,...", TEXT, AT(envelope), "", 0, 0,
     "How bakes make the family envelope, as `lodestream bake --envelope`: nested=1 for deltas between its levels."},
    {"bakes", "N", COUNT, AT(bakes), "1", 1, 64,
     "Bakes at once, each in a process of its own; with later-families one more, of a model that is not served yet."},
    {"bake-threads", "N", COUNT, AT(bake_threads), "0", 0, 256, "Threads of one bake; 0: one a processor."},
    {"bake-queue", "N", COUNT, AT(bake_queue), "64", 1, 100000, "Bakes that may wait; more are refused with 503."},
    {"bake-seconds", "N", COUNT, AT(bake_seconds), "600", 1, 86400, "A bake that takes longer is stopped and fails."},
    {"bake-memory", "N", BYTES, AT(bake_memory), "8GiB", UINT64_C(1) << 26, UINT64_C(1) << 44,
     "Memory of one bake; with later-families there is one more than bakes says."},
    {"refine-workers", "N", COUNT, AT(refine_workers), "2", 0, 64, "Refinements at once, each in a warm worker; 0: none are answered."},
    {"refine-queue", "N", COUNT, AT(refine_queue), "32", 1, 100000, "Refinements that may wait; more are told to come back later."},
    {"refine-seconds", "N", COUNT, AT(refine_seconds), "10", 1, 3600, "A refinement that is not there after this long is given up."},
    {"refine-memory", "N", BYTES, AT(refine_memory), "2GiB", UINT64_C(1) << 26, UINT64_C(1) << 44, "Memory of one refinement worker."},
    {"refine-triangles", "N", COUNT, AT(refine_triangles), "500000", 1, UINT64_C(1) << 28,
     "The most triangles of a refinement, whatever is asked for."},
    {"refined-bytes", "N", BYTES, AT(refined_bytes), "256MiB", 0, UINT64_C(1) << 50,
     "Refinements kept on the disk for whoever asks the same again; the least recently used go; 0: none."},
    {"limit-vertices", "N", COUNT, AT(limit_vertices), "0", 0, UINT32_MAX, "Most vertices of a model; 0: the worker's default."},
    {"limit-triangles", "N", COUNT, AT(limit_triangles), "0", 0, UINT32_MAX, "Most triangles of a model; 0: the worker's default."},
    {"limit-instances", "N", COUNT, AT(limit_instances), "0", 0, UINT32_MAX, "Most instances of a model's parts; 0: the worker's default."},
    {"limit-depth", "N", COUNT, AT(limit_depth), "0", 0, 10000, "Deepest node tree of a model; 0: the worker's default."},
    {"limit-texture-pixels", "N", COUNT, AT(limit_texture_pixels), "0", 0, 65536,
     "Largest width or height of a texture; 0: the worker's default."},
    {"limit-texture-bytes", "N", BYTES, AT(limit_texture_bytes), "0", 0, UINT64_C(1) << 40,
     "Most bytes of one texture; 0: the worker's default."},
#undef AT
};
enum { SETTING_COUNT = sizeof kSettings / sizeof *kSettings };

static char **text_of(struct lod_config *config, const struct setting *setting) {
  return (char **)((char *)config + setting->offset);
}
static uint64_t *count_of(struct lod_config *config, const struct setting *setting) {
  return (uint64_t *)((char *)config + setting->offset);
}

static const struct setting *find_setting(const char *name, size_t size) {
  for (size_t i = 0; i < SETTING_COUNT; i++)
    if (strlen(kSettings[i].name) == size && strncmp(kSettings[i].name, name, size) == 0)
      return &kSettings[i];
  return NULL;
}

/* 12, 64KiB, 1GiB; "K" and "KB" alone mean 1024 too. */
static bool parse_count(const char *text, enum kind kind, uint64_t *value) {
  static const char kUnits[] = "KMGT";
  char *end;
  errno = 0;
  if (*text < '0' || *text > '9')
    return false;
  *value = strtoull(text, &end, 10);
  if (errno)
    return false;
  const char *unit = kind == BYTES && *end ? strchr(kUnits, *end) : NULL;
  if (unit) {
    int shift = 10 * (int)(unit - kUnits + 1);
    if (*value > UINT64_MAX >> shift)
      return false;
    *value <<= shift;
    end++;
    end += end[0] == 'i' && end[1] == 'B' ? 2 : end[0] == 'B' ? 1 : 0;
  }
  return *end == 0;
}

bool lod_config_parse_bytes(const char *text, uint64_t *value) {
  return parse_count(text, BYTES, value);
}

/* where: "--loops" or "file, line 3". */
static enum lod_status set(const struct setting *setting, const char *text, const char *where, struct lod_config *config,
                           struct lod_problem *problem) {
  if (setting->kind == TEXT) {
    char *copy = strdup(text);
    if (!copy)
      return lod_fail_memory(problem);
    free(*text_of(config, setting));
    *text_of(config, setting) = copy;
    return LOD_OK;
  }
  uint64_t value;
  if (!parse_count(text, setting->kind, &value) || value < setting->minimum || value > setting->maximum)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "%s: '%s' must be a number from %llu to %llu, not '%s'.", where, setting->name,
                    (unsigned long long)setting->minimum, (unsigned long long)setting->maximum, text);
  *count_of(config, setting) = value;
  return LOD_OK;
}

enum lod_status lod_config_read_text(const char *name, const char *text, struct lod_config *config, struct lod_problem *problem) {
  unsigned number = 0;
  for (const char *line = text; *line;) {
    number++;
    size_t size = strcspn(line, "\n");
    const char *next = line + size + (line[size] == '\n');
    while (size && strchr(" \t\r", *line))
      line++, size--;
    while (size && strchr(" \t\r", line[size - 1]))
      size--;
    if (size && *line != '#') {
      char where[300], value[4096];
      snprintf(where, sizeof where, "%s, line %u", name, number);
      const char *equals = memchr(line, '=', size);
      size_t key_size = equals ? (size_t)(equals - line) : 0;
      while (key_size && strchr(" \t", line[key_size - 1]))
        key_size--;
      const struct setting *setting = find_setting(line, key_size);
      if (!equals)
        return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "%s: expected `key = value`.", where);
      if (!setting)
        return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "%s: there is no setting '%.*s'.", where, (int)key_size, line);
      const char *begin = equals + 1;
      begin += strspn(begin, " \t");
      size_t value_size = begin < line + size ? (size_t)(line + size - begin) : 0;
      if (value_size >= sizeof value)
        return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "%s: the value is too long.", where);
      memcpy(value, begin, value_size);
      value[value_size] = 0;
      LOD_TRY(set(setting, value, where, config, problem));
    }
    line = next;
  }
  return LOD_OK;
}

static enum lod_status read_file(const char *path, struct lod_config *config, struct lod_problem *problem) {
  FILE *file = fopen(path, "re");
  if (!file)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--config: cannot read '%s': %s.", path, strerror(errno));
  char text[65536];
  size_t size = fread(text, 1, sizeof text - 1, file);
  bool whole = feof(file) && !ferror(file);
  fclose(file);
  text[size] = 0;
  if (!whole || strlen(text) != size)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--config: '%s' is not a text file below 64 KiB.", path);
  return lod_config_read_text(path, text, config, problem);
}

/* Walks the flags. file: only finds --config; else sets all but that. */
static enum lod_status read_flags(int argc, char *const *argv, bool file, const char **path, struct lod_config *config,
                                  enum lod_config_action *action, struct lod_problem *problem) {
  for (int i = 1; i < argc; i++) {
    const char *flag = argv[i];
    if (strcmp(flag, "--help") == 0 || strcmp(flag, "-h") == 0)
      *action = LOD_CONFIG_HELP;
    else if (strcmp(flag, "--version") == 0)
      *action = LOD_CONFIG_VERSION;
    else if (strcmp(flag, "--check-store") == 0)
      *action = LOD_CONFIG_CHECK_STORE;
    else if (strcmp(flag, "--repair-store") == 0)
      *action = LOD_CONFIG_REPAIR_STORE;
    else if (strcmp(flag, "--make-token") == 0 && i + 1 < argc) {
      *action = LOD_CONFIG_MAKE_TOKEN;
      free(config->token_name);
      if ((config->token_name = strdup(argv[++i])) == NULL)
        return lod_fail_memory(problem);
    } else if (strncmp(flag, "--", 2) != 0)
      return lod_fail(problem, LOD_BAD_INPUT, "bad-flag", "'%s' is not a flag; try --help.", flag);
    else {
      size_t size = strcspn(flag + 2, "=");
      const struct setting *setting = find_setting(flag + 2, size);
      bool is_config = size == 6 && strncmp(flag + 2, "config", 6) == 0;
      if (!setting && !is_config)
        return lod_fail(problem, LOD_BAD_INPUT, "bad-flag", "There is no flag '%s'; try --help.", flag);
      const char *value = flag[2 + size] == '=' ? flag + 3 + size : i + 1 < argc ? argv[++i] : NULL;
      if (!value)
        return lod_fail(problem, LOD_BAD_INPUT, "bad-flag", "'%s' needs a value; try --help.", flag);
      if (is_config)
        *path = value;
      else if (!file)
        LOD_TRY(set(setting, value, flag, config, problem));
    }
  }
  return LOD_OK;
}

/* First of two paths relative to the program's folder that is there; "" when none is. */
static char *beside(const char *program, const char *first, const char *second) {
  const char *slash = strrchr(program, '/');
  int size = slash ? (int)(slash - program) : 1;
  for (int i = 0; i < 2; i++) {
    char *path = NULL;
    const char *name = i == 0 ? first : second;
    if (!name)
      break;
    if (asprintf(&path, "%.*s/%s", size, slash ? program : ".", name) < 0)
      return NULL;
    if (access(path, R_OK) == 0)
      return path;
    free(path);
  }
  return strdup("");
}

enum lod_status lod_config_read(int argc, char *const *argv, const char *program, struct lod_config *config, enum lod_config_action *action,
                                struct lod_problem *problem) {
  *config = (struct lod_config){0};
  *action = LOD_CONFIG_RUN;
  for (size_t i = 0; i < SETTING_COUNT; i++)
    LOD_TRY(set(&kSettings[i], kSettings[i].otherwise, "default", config, problem));
  const char *path = NULL;
  LOD_TRY(read_flags(argc, argv, true, &path, config, action, problem));
  if (*action == LOD_CONFIG_HELP || *action == LOD_CONFIG_VERSION || *action == LOD_CONFIG_MAKE_TOKEN)
    return LOD_OK;
  if (path)
    LOD_TRY(read_file(path, config, problem));
  LOD_TRY(read_flags(argc, argv, false, &path, config, action, problem));
  if (!*config->store)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-flag", "--store DIR is missing; try --help.");
  if (!*config->tls_cert != !*config->tls_key)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-flag", "--tls-cert and --tls-key go together.");
  if (strcmp(config->log, "text") != 0 && strcmp(config->log, "json") != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "bad-flag", "--log must be text or json, not '%s'.", config->log);
  char **found[2] = {&config->viewer, &config->worker};
  for (int i = 0; i < 2; i++)
    if (!**found[i]) {
      char *there = i == 0 ? beside(program, "../web", "../share/lodestream/web") : beside(program, "lodestream", NULL);
      if (!there)
        return lod_fail_memory(problem);
      free(*found[i]);
      *found[i] = there;
    }
  return LOD_OK;
}

void lod_config_finish(struct lod_config *config) {
  for (size_t i = 0; i < SETTING_COUNT; i++)
    if (kSettings[i].kind == TEXT) {
      free(*text_of(config, &kSettings[i]));
      *text_of(config, &kSettings[i]) = NULL;
    }
  free(config->token_name);
  config->token_name = NULL;
}

void lod_config_help(FILE *out) {
  fputs("lodestreamd: serves levels of detail of 3-D models over HTTP.\n\n"
        "  lodestreamd --store DIR [--listen HOST:PORT] [--models DIR] [setting ...]\n\n"
        "Settings, as flags (--name VALUE) or as lines `name = value` of the file that --config names; flags win.\n\n",
        out);
  for (size_t i = 0; i < SETTING_COUNT; i++) {
    const struct setting *setting = &kSettings[i];
    fprintf(out, "  --%s %s%s%s%s\n        %s\n", setting->name, setting->value, *setting->otherwise ? "  [" : "", setting->otherwise,
            *setting->otherwise ? "]" : "", setting->sentence);
  }
  fputs(
      "  --config FILE\n        Settings to read before the flags; # begins a comment line.\n"
      "  --check-store, --repair-store\n        Check the whole of --store, or mend it, and end; no daemon may hold it. Status 0: sound, "
      "1: "
      "something was found.\n"
      "  --make-token NAME\n        Print a fresh token and its line for --token-file.\n"
      "  --help, --version\n\n"
      "SIGHUP reads the file, the flags, the tokens and the certificate again; what cannot change in a running daemon is named in the "
      "log.\n"
      "SIGTERM and SIGINT let answers in progress finish, then stop. Exit status: 0 stopped as asked, 1 could not start, 2 wrong usage.\n",
      out);
}

/* What a running daemon takes over. */
static const char *const kLive[] = {"token-file",    "tls-cert",       "tls-key",      "cors",         "log-level",
                                    "wait-seconds",  "header-seconds", "idle-seconds", "rate-seconds", "rate-bytes",
                                    "drain-seconds", "upload-bytes",   "store-bytes",  "refined-bytes"};

void lod_config_fixed_differences(const struct lod_config *a, const struct lod_config *b, char *names, size_t size) {
  *names = 0;
  for (size_t i = 0; i < SETTING_COUNT; i++) {
    const struct setting *setting = &kSettings[i];
    bool live = false;
    for (size_t k = 0; k < sizeof kLive / sizeof *kLive; k++)
      live |= strcmp(kLive[k], setting->name) == 0;
    bool same = setting->kind == TEXT ? strcmp(*text_of((struct lod_config *)a, setting), *text_of((struct lod_config *)b, setting)) == 0
                                      : *count_of((struct lod_config *)a, setting) == *count_of((struct lod_config *)b, setting);
    size_t used = strlen(names);
    if (!live && !same && used < size)
      snprintf(names + used, size - used, "%s%s", used ? " " : "", setting->name);
  }
}

char *lod_config_limits_json(const struct lod_config *config) {
  const struct {
    const char *name;
    uint64_t value;
  } limits[] = {{"vertices", config->limit_vertices},
                {"triangles", config->limit_triangles},
                {"instances", config->limit_instances},
                {"depth", config->limit_depth},
                {"texture_pixels", config->limit_texture_pixels},
                {"texture_bytes", config->limit_texture_bytes}};
  char text[512] = "{";
  size_t used = 1;
  for (size_t i = 0; i < sizeof limits / sizeof *limits; i++)
    if (limits[i].value)
      used += (size_t)snprintf(text + used, sizeof text - used, "%s\"%s\":%llu", used > 1 ? "," : "", limits[i].name,
                               (unsigned long long)limits[i].value);
  snprintf(text + used, sizeof text - used, "}");
  return strdup(text);
}

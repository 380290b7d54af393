#include "server/store/catalog.h"

#include <pthread.h>
#include <sqlite3.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct lod_catalog {
  sqlite3 *database;
  pthread_mutex_t mutex;
};

static const char kSchema[] =
    "CREATE TABLE IF NOT EXISTS objects (sha256 TEXT PRIMARY KEY, type TEXT NOT NULL, bytes INTEGER NOT NULL) WITHOUT ROWID;"
    "CREATE TABLE IF NOT EXISTS models (id TEXT PRIMARY KEY, revision TEXT NOT NULL, manifest TEXT NOT NULL, created REAL NOT NULL) "
    "WITHOUT ROWID;"
    "CREATE TABLE IF NOT EXISTS names (model TEXT NOT NULL, sha256 TEXT NOT NULL, PRIMARY KEY (model, sha256)) WITHOUT ROWID;"
    "CREATE INDEX IF NOT EXISTS names_by_object ON names (sha256);"
    "CREATE TABLE IF NOT EXISTS jobs (number INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL, name TEXT NOT NULL, format TEXT,"
    " state INTEGER NOT NULL, attempts INTEGER NOT NULL, created REAL NOT NULL, finished REAL NOT NULL,"
    " status INTEGER NOT NULL, type TEXT NOT NULL, detail TEXT NOT NULL);";
/* What each later version added; kSteps[i] makes version i + 1 of version i. */
static const char *const kSteps[] = {
    kSchema,
    "ALTER TABLE jobs ADD COLUMN later INTEGER NOT NULL DEFAULT 0;",
};
enum { SCHEMA_VERSION = sizeof kSteps / sizeof kSteps[0] };

/* ---- SQLite in a few words ---- */

static enum lod_status fail(struct lod_catalog *catalog, int code, struct lod_problem *problem) {
  const char *text = catalog->database == NULL ? sqlite3_errstr(code) : sqlite3_errmsg(catalog->database);
  switch (code & 0xff) {
  case SQLITE_NOMEM:
    return lod_fail_memory(problem);
  case SQLITE_FULL:
    return lod_fail(problem, LOD_IO, "disk-full", "The catalogue could not be written because the disk is full. Nothing was changed.");
  case SQLITE_READONLY:
  case SQLITE_CANTOPEN:
  case SQLITE_PERM:
    return lod_fail(problem, LOD_IO, "store-read-only", "The catalogue cannot be written: %s. The store must be a writable directory.",
                    text);
  case SQLITE_CORRUPT:
  case SQLITE_NOTADB:
    return lod_fail(problem, LOD_IO, "store-corrupt", "The catalogue is damaged: %s. Restore catalog.sqlite from a backup.", text);
  default:
    return lod_fail(problem, LOD_IO, "store-error", "The catalogue failed: %s (SQLite code %d).", text, code);
  }
}

/* One letter of `types` a parameter: s text or NULL, m text with a size_t length behind it, i int64_t, d double. */
static int prepare(struct lod_catalog *catalog, sqlite3_stmt **statement, const char *sql, const char *types, va_list values) {
  int code = sqlite3_prepare_v2(catalog->database, sql, -1, statement, NULL);
  for (int i = 1; code == SQLITE_OK && *types != 0; types++, i++) {
    if (*types == 's') {
      code = sqlite3_bind_text(*statement, i, va_arg(values, const char *), -1, SQLITE_STATIC);
    } else if (*types == 'm') {
      const char *text = va_arg(values, const char *);
      code = sqlite3_bind_text64(*statement, i, text, va_arg(values, size_t), SQLITE_STATIC, SQLITE_UTF8);
    } else if (*types == 'i') {
      code = sqlite3_bind_int64(*statement, i, va_arg(values, int64_t));
    } else {
      code = sqlite3_bind_double(*statement, i, va_arg(values, double));
    }
  }
  return code;
}

/* Runs a statement without rows, or whose first row's first column is *result (may be NULL). */
static int run(struct lod_catalog *catalog, int64_t *result, const char *sql, const char *types, ...) {
  sqlite3_stmt *statement = NULL;
  va_list values;
  va_start(values, types);
  int code = prepare(catalog, &statement, sql, types, values);
  va_end(values);
  if (code == SQLITE_OK)
    code = sqlite3_step(statement);
  if (code == SQLITE_ROW && result != NULL)
    *result = sqlite3_column_int64(statement, 0);
  int end = sqlite3_finalize(statement);
  if (code == SQLITE_ROW || code == SQLITE_DONE)
    code = SQLITE_OK;
  return code == SQLITE_OK ? end : code;
}

static const char *text_at(sqlite3_stmt *statement, int column) {
  const unsigned char *text = sqlite3_column_text(statement, column);
  return text == NULL ? "" : (const char *)text;
}

/* Rows of a query without parameters, each to `row`. */
typedef enum lod_status row_function(sqlite3_stmt *statement, void *each, void *context);

struct walk {
  const char *sql;
  row_function *row;
  void *each; /* points to the caller's callback */
  void *context;
};

static enum lod_status read_rows(struct lod_catalog *catalog, const struct walk *walk, struct lod_problem *problem) {
  pthread_mutex_lock(&catalog->mutex);
  sqlite3_stmt *statement = NULL;
  enum lod_status status = LOD_OK;
  int code = sqlite3_prepare_v2(catalog->database, walk->sql, -1, &statement, NULL);
  while (code == SQLITE_OK && status == LOD_OK) {
    code = sqlite3_step(statement);
    if (code == SQLITE_ROW) {
      status = walk->row(statement, walk->each, walk->context);
      code = SQLITE_OK;
    }
  }
  if (status == LOD_OK && code != SQLITE_DONE)
    status = fail(catalog, code, problem);
  sqlite3_finalize(statement);
  pthread_mutex_unlock(&catalog->mutex);
  return status;
}

/* Commits when code is SQLITE_OK, else undoes; a failed commit is undone as well. */
static int end_transaction(struct lod_catalog *catalog, int code) {
  if (code == SQLITE_OK)
    code = run(catalog, NULL, "COMMIT", "");
  if (code != SQLITE_OK && !sqlite3_get_autocommit(catalog->database))
    (void)run(catalog, NULL, "ROLLBACK", "");
  return code;
}

/* ---- open and close ---- */

/* A pragma takes no parameter. */
static int set_version(struct lod_catalog *catalog) {
  char text[48];
  snprintf(text, sizeof text, "PRAGMA user_version = %d", SCHEMA_VERSION);
  return run(catalog, NULL, text, "");
}

static enum lod_status set_up(struct lod_catalog *catalog, struct lod_problem *problem) {
  int64_t version = 0;
  int code = run(catalog, NULL, "PRAGMA journal_mode = WAL", "");
  if (code == SQLITE_OK)
    code = run(catalog, NULL, "PRAGMA synchronous = FULL", "");
  if (code == SQLITE_OK)
    code = run(catalog, &version, "PRAGMA user_version", "");
  if (code == SQLITE_OK && version > SCHEMA_VERSION)
    return lod_fail(problem, LOD_UNSUPPORTED, "store-newer",
                    "The store was written by a newer Lodestream (catalogue version %lld, known: %d).", (long long)version, SCHEMA_VERSION);
  if (code == SQLITE_OK && version < SCHEMA_VERSION) {
    code = run(catalog, NULL, "BEGIN IMMEDIATE", "");
    for (int64_t step = version; code == SQLITE_OK && step < SCHEMA_VERSION; step++)
      code = sqlite3_exec(catalog->database, kSteps[step], NULL, NULL, NULL);
    if (code == SQLITE_OK)
      code = set_version(catalog);
    code = end_transaction(catalog, code);
  }
  return code == SQLITE_OK ? LOD_OK : fail(catalog, code, problem);
}

enum lod_status lod_catalog_open(const char *path, struct lod_catalog **catalog, struct lod_problem *problem) {
  *catalog = NULL;
  struct lod_catalog *result = calloc(1, sizeof *result);
  if (result == NULL)
    return lod_fail_memory(problem);
  pthread_mutex_init(&result->mutex, NULL);
  int code = sqlite3_open_v2(path, &result->database, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_FULLMUTEX, NULL);
  enum lod_status status = LOD_OK;
  if (code == SQLITE_OK) {
    sqlite3_busy_timeout(result->database, 5000); /* for people who look into it with sqlite3 meanwhile */
    status = set_up(result, problem);
  } else {
    status = fail(result, code, problem);
  }
  if (status != LOD_OK) {
    lod_catalog_close(result);
    return status;
  }
  *catalog = result;
  return LOD_OK;
}

void lod_catalog_close(struct lod_catalog *catalog) {
  if (catalog == NULL)
    return;
  sqlite3_close_v2(catalog->database);
  pthread_mutex_destroy(&catalog->mutex);
  free(catalog);
}

enum lod_status lod_catalog_check(struct lod_catalog *catalog, struct lod_problem *problem) {
  pthread_mutex_lock(&catalog->mutex);
  int code = run(catalog, NULL, "SELECT count(*) FROM (SELECT 1 FROM models LIMIT 1)", "");
  enum lod_status status = code == SQLITE_OK ? LOD_OK : fail(catalog, code, problem);
  pthread_mutex_unlock(&catalog->mutex);
  return status;
}

enum lod_status lod_catalog_check_whole(struct lod_catalog *catalog, struct lod_problem *problem) {
  pthread_mutex_lock(&catalog->mutex);
  sqlite3_stmt *statement = NULL;
  int code = sqlite3_prepare_v2(catalog->database, "PRAGMA integrity_check(1)", -1, &statement, NULL);
  if (code == SQLITE_OK)
    code = sqlite3_step(statement);
  enum lod_status status = LOD_OK;
  if (code != SQLITE_ROW)
    status = fail(catalog, code, problem);
  else if (strcmp(text_at(statement, 0), "ok") != 0)
    status = lod_fail(problem, LOD_IO, "store-corrupt", "The catalogue is damaged: %.200s. Restore catalog.sqlite from a backup.",
                      text_at(statement, 0));
  sqlite3_finalize(statement);
  pthread_mutex_unlock(&catalog->mutex);
  return status;
}

/* ---- models and objects ---- */

static enum lod_status object_row(sqlite3_stmt *statement, void *each, void *context) {
  struct lod_catalog_object object = {text_at(statement, 0), text_at(statement, 1), (uint64_t)sqlite3_column_int64(statement, 2)};
  return (*(lod_catalog_each_object **)each)(context, &object);
}

enum lod_status lod_catalog_read_objects(struct lod_catalog *catalog, lod_catalog_each_object *each, void *context,
                                         struct lod_problem *problem) {
  return read_rows(catalog, &(struct walk){"SELECT sha256, type, bytes FROM objects", object_row, &each, context}, problem);
}

static enum lod_status model_row(sqlite3_stmt *statement, void *each, void *context) {
  struct lod_catalog_model model = {.id = text_at(statement, 0),
                                    .revision = text_at(statement, 1),
                                    .manifest = text_at(statement, 2),
                                    .manifest_size = (size_t)sqlite3_column_bytes(statement, 2),
                                    .created = sqlite3_column_double(statement, 3)};
  return (*(lod_catalog_each_model **)each)(context, &model);
}

enum lod_status lod_catalog_read_models(struct lod_catalog *catalog, lod_catalog_each_model *each, void *context,
                                        struct lod_problem *problem) {
  return read_rows(catalog, &(struct walk){"SELECT id, revision, manifest, created FROM models ORDER BY id", model_row, &each, context},
                   problem);
}

/* Objects lose their row when the last name goes. */
static int drop_names(struct lod_catalog *catalog, const char *model) {
  int code = run(catalog, NULL,
                 "DELETE FROM objects WHERE sha256 IN (SELECT sha256 FROM names WHERE model = ?1 AND NOT EXISTS "
                 "(SELECT 1 FROM names AS other WHERE other.sha256 = names.sha256 AND other.model <> ?1))",
                 "s", model);
  return code == SQLITE_OK ? run(catalog, NULL, "DELETE FROM names WHERE model = ?", "s", model) : code;
}

static int put_model(struct lod_catalog *catalog, const struct lod_catalog_model *model) {
  int code = drop_names(catalog, model->id);
  for (size_t i = 0; code == SQLITE_OK && i < model->object_count; i++) {
    const struct lod_catalog_object *object = &model->objects[i];
    code = run(catalog, NULL, "INSERT OR REPLACE INTO objects (sha256, type, bytes) VALUES (?, ?, ?)", "ssi", object->sha256, object->type,
               (int64_t)object->bytes);
    if (code == SQLITE_OK)
      code = run(catalog, NULL, "INSERT INTO names (model, sha256) VALUES (?, ?)", "ss", model->id, object->sha256);
  }
  return code == SQLITE_OK ? run(catalog, NULL, "INSERT OR REPLACE INTO models (id, revision, manifest, created) VALUES (?, ?, ?, ?)",
                                 "ssmd", model->id, model->revision, model->manifest, model->manifest_size, model->created)
                           : code;
}

enum lod_status lod_catalog_put_model(struct lod_catalog *catalog, const struct lod_catalog_model *model, uint64_t quota_bytes,
                                      struct lod_problem *problem) {
  enum lod_status status = LOD_OK;
  int64_t total = 0;
  pthread_mutex_lock(&catalog->mutex);
  int code = run(catalog, NULL, "BEGIN IMMEDIATE", "");
  if (code == SQLITE_OK)
    code = put_model(catalog, model);
  if (code == SQLITE_OK && quota_bytes != 0)
    code = run(catalog, &total, "SELECT coalesce(sum(bytes), 0) FROM objects", "");
  if (code == SQLITE_OK && quota_bytes != 0 && (uint64_t)total > quota_bytes) {
    status = lod_fail(problem, LOD_LIMIT, "quota", "With this model the store would hold %lld bytes of objects; the quota is %llu.",
                      (long long)total, (unsigned long long)quota_bytes);
    (void)end_transaction(catalog, SQLITE_ABORT);
  } else {
    if (code != SQLITE_OK)
      status = fail(catalog, code, problem); /* before ROLLBACK clears the message */
    code = end_transaction(catalog, code);
    if (status == LOD_OK && code != SQLITE_OK)
      status = fail(catalog, code, problem);
  }
  pthread_mutex_unlock(&catalog->mutex);
  return status;
}

static int end_jobs(struct lod_catalog *catalog, const char *id, const struct lod_catalog_ending *ending) {
  return run(catalog, NULL,
             "UPDATE jobs SET state = ?, finished = ?, status = ?, type = ?, detail = ? WHERE id = ? AND number <= ? AND state < ?",
             "idisssii", (int64_t)ending->state, ending->finished, (int64_t)ending->problem->status, ending->problem->type,
             ending->problem->detail, id, (int64_t)ending->last, (int64_t)ending->open_states);
}

enum lod_status lod_catalog_delete_model(struct lod_catalog *catalog, const char *id, const struct lod_catalog_ending *ending,
                                         bool *existed, struct lod_problem *problem) {
  pthread_mutex_lock(&catalog->mutex);
  enum lod_status status = LOD_OK;
  int code = run(catalog, NULL, "BEGIN IMMEDIATE", "");
  if (code == SQLITE_OK)
    code = drop_names(catalog, id);
  if (code == SQLITE_OK && ending != NULL)
    code = end_jobs(catalog, id, ending);
  if (code == SQLITE_OK)
    code = run(catalog, NULL, "DELETE FROM models WHERE id = ?", "s", id);
  *existed = code == SQLITE_OK && sqlite3_changes(catalog->database) > 0;
  if (code != SQLITE_OK)
    status = fail(catalog, code, problem);
  code = end_transaction(catalog, code);
  if (status == LOD_OK && code != SQLITE_OK)
    status = fail(catalog, code, problem);
  pthread_mutex_unlock(&catalog->mutex);
  return status;
}

/* ---- jobs ---- */

static enum lod_status job_row(sqlite3_stmt *statement, void *each, void *context) {
  struct lod_catalog_job job = {.number = (uint64_t)sqlite3_column_int64(statement, 0),
                                .id = text_at(statement, 1),
                                .name = text_at(statement, 2),
                                .format = (const char *)sqlite3_column_text(statement, 3),
                                .state = sqlite3_column_int(statement, 4),
                                .attempts = (uint32_t)sqlite3_column_int(statement, 5),
                                .created = sqlite3_column_double(statement, 6),
                                .finished = sqlite3_column_double(statement, 7),
                                .later = sqlite3_column_int(statement, 11) != 0};
  int status = sqlite3_column_int(statement, 8);
  if (status != LOD_OK)
    (void)lod_fail(&job.problem, (enum lod_status)status, text_at(statement, 9), "%s", text_at(statement, 10));
  return (*(lod_catalog_each_job **)each)(context, &job);
}

enum lod_status lod_catalog_read_jobs(struct lod_catalog *catalog, lod_catalog_each_job *each, void *context, struct lod_problem *problem) {
  return read_rows(
      catalog,
      &(struct walk){"SELECT number, id, name, format, state, attempts, created, finished, status, type, detail, later FROM jobs"
                     " ORDER BY number",
                     job_row, &each, context},
      problem);
}

enum lod_status lod_catalog_put_job(struct lod_catalog *catalog, const struct lod_catalog_job *job, struct lod_problem *problem) {
  pthread_mutex_lock(&catalog->mutex);
  int code = run(catalog, NULL,
                 "INSERT INTO jobs (number, id, name, format, state, attempts, created, finished, status, type, detail, later)"
                 " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (number) DO UPDATE SET state = excluded.state,"
                 " attempts = excluded.attempts, finished = excluded.finished, status = excluded.status, type = excluded.type,"
                 " detail = excluded.detail",
                 "isssiiddissi", (int64_t)job->number, job->id, job->name, job->format, (int64_t)job->state, (int64_t)job->attempts,
                 job->created, job->finished, (int64_t)job->problem.status, job->problem.type, job->problem.detail, (int64_t)job->later);
  enum lod_status status = code == SQLITE_OK ? LOD_OK : fail(catalog, code, problem);
  pthread_mutex_unlock(&catalog->mutex);
  return status;
}

enum lod_status lod_catalog_delete_job(struct lod_catalog *catalog, uint64_t number, struct lod_problem *problem) {
  pthread_mutex_lock(&catalog->mutex);
  int code = run(catalog, NULL, "DELETE FROM jobs WHERE number = ?", "i", (int64_t)number);
  enum lod_status status = code == SQLITE_OK ? LOD_OK : fail(catalog, code, problem);
  pthread_mutex_unlock(&catalog->mutex);
  return status;
}

enum lod_status lod_catalog_last_job(struct lod_catalog *catalog, uint64_t *number, struct lod_problem *problem) {
  int64_t last = 0;
  pthread_mutex_lock(&catalog->mutex);
  int code = run(catalog, &last, "SELECT seq FROM sqlite_sequence WHERE name = 'jobs'", "");
  enum lod_status status = code == SQLITE_OK ? LOD_OK : fail(catalog, code, problem);
  pthread_mutex_unlock(&catalog->mutex);
  *number = (uint64_t)last;
  return status;
}

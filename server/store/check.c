#include "server/store/check.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <nettle/sha2.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/jobs/jobs.h"
#include "server/store/answers.h"
#include "server/store/catalog.h"
#include "server/store/files.h"
#include "server/store/manifest.h"
#include "server/store/table.h"

enum { CHUNK = 1 << 18 };

struct object {
  char sha256[LOD_SHA256_HEX + 1];
  uint64_t bytes;
  bool bad;
};

struct model_name {
  char id[LOD_MODEL_ID_MAX + 1];
  bool whole;
  struct model_name *next;
};

struct check {
  int directory_fd, objects_fd, uploads_fd, lock_fd;
  bool repair;
  FILE *out;
  struct lod_store_findings *findings;
  struct lod_problem *problem;
  struct lod_catalog *catalog;
  struct lod_table objects; /* sha256 -> struct object */
  struct model_name *models;
  uint8_t *buffer;
};

__attribute__((format(printf, 2, 3))) static void tell(const struct check *check, const char *format, ...) {
  if (!check->out)
    return;
  va_list arguments;
  va_start(arguments, format);
  vfprintf(check->out, format, arguments);
  va_end(arguments);
  fputc('\n', check->out);
}

/* ---- objects ---- */

static enum lod_status hold_object(void *context, const struct lod_catalog_object *row) {
  struct check *check = context;
  struct object *object = calloc(1, sizeof *object);
  if (!object || !lod_table_reserve(&check->objects)) {
    free(object);
    return lod_fail_memory(check->problem);
  }
  snprintf(object->sha256, sizeof object->sha256, "%s", row->sha256);
  object->bytes = row->bytes;
  lod_table_insert(&check->objects, object->sha256, object);
  check->findings->objects++;
  check->findings->bytes += row->bytes;
  return LOD_OK;
}

static void forget_objects(struct check *check) {
  size_t position = 0;
  for (struct object *object; (object = lod_table_next(&check->objects, &position)) != NULL;)
    free(object);
  lod_table_finish(&check->objects);
}

/* "", or what is wrong. */
static const char *judge(struct check *check, const struct object *object) {
  char path[LOD_SHA256_HEX + 8], digest_text[LOD_SHA256_HEX + 1];
  snprintf(path, sizeof path, "%.2s/%s", object->sha256, object->sha256);
  int fd = openat(check->objects_fd, path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
  struct stat facts;
  if (fd < 0)
    return errno == ENOENT ? "missing" : "unreadable";
  const char *wrong = fstat(fd, &facts) != 0 || !S_ISREG(facts.st_mode) ? "not a regular file"
                      : (uint64_t)facts.st_size != object->bytes        ? "of another size"
                                                                        : "";
  struct sha256_ctx hash;
  uint8_t digest[SHA256_DIGEST_SIZE];
  sha256_init(&hash);
  while (!*wrong) {
    ssize_t got = read(fd, check->buffer, CHUNK);
    if (got == 0)
      break;
    if (got < 0 && errno != EINTR)
      wrong = "unreadable";
    if (got > 0)
      sha256_update(&hash, (size_t)got, check->buffer);
  }
  close(fd);
  sha256_digest(&hash, sizeof digest, digest);
  for (size_t i = 0; i < sizeof digest; i++)
    snprintf(digest_text + 2 * i, 3, "%02x", digest[i]);
  return *wrong ? wrong : strcmp(digest_text, object->sha256) == 0 ? "" : "damaged: its bytes have another SHA-256";
}

static void put_aside(struct check *check, const char *sha256) {
  char path[LOD_SHA256_HEX + 8], place[LOD_SHA256_HEX + 16];
  snprintf(path, sizeof path, "%.2s/%s", sha256, sha256);
  snprintf(place, sizeof place, "lost+found/%s", sha256);
  if (mkdirat(check->directory_fd, "lost+found", 0700) != 0 && errno != EEXIST)
    return;
  if (renameat(check->objects_fd, path, check->directory_fd, place) == 0)
    check->findings->repaired++;
}

static void check_objects(struct check *check) {
  size_t position = 0;
  for (struct object *object; (object = lod_table_next(&check->objects, &position)) != NULL;) {
    const char *wrong = judge(check, object);
    object->bad = *wrong != 0;
    if (!object->bad)
      continue;
    bool missing = strcmp(wrong, "missing") == 0;
    *(missing ? &check->findings->missing : &check->findings->damaged) += 1;
    tell(check, "object %s is %s", object->sha256, wrong);
    if (check->repair && !missing)
      put_aside(check, object->sha256);
  }
}

static void check_strays(struct check *check) {
  for (int i = 0; i < 256; i++) {
    char name[3];
    snprintf(name, sizeof name, "%02x", i);
    int fd = openat(check->objects_fd, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0)
      continue;
    struct lod_name_list names = lod_list_folder(fd);
    for (size_t k = 0; k < names.count; k++) {
      if (lod_table_find(&check->objects, names.names[k]))
        continue;
      check->findings->stray++;
      tell(check, "file objects/%s/%.80s belongs to no model%s", name, names.names[k], check->repair ? ": removed" : "");
      if (check->repair) {
        lod_remove_tree(fd, names.names[k]);
        check->findings->repaired++;
      }
    }
    lod_name_list_finish(&names);
    close(fd);
  }
}

/* ---- models and jobs ---- */

static enum lod_status check_model(void *context, const struct lod_catalog_model *row) {
  struct check *check = context;
  struct lod_manifest *manifest = NULL;
  struct lod_problem local = {0};
  bool broken = false;
  check->findings->models++;
  if (lod_manifest_parse(row->manifest, row->manifest_size, row->id, &manifest, &local) != LOD_OK) {
    broken = true;
    tell(check, "model %s has no proper manifest: %s", row->id, local.detail);
  }
  size_t bad = 0;
  for (size_t i = 0; manifest && i < manifest->object_count; i++) {
    const struct object *object = lod_table_find(&check->objects, manifest->objects[i].sha256);
    bad += !object || object->bad;
  }
  if (bad)
    tell(check, "model %s cannot be served whole: %zu of its %zu objects are damaged or missing; upload it again", row->id, bad,
         manifest->object_count);
  lod_manifest_destroy(manifest);
  check->findings->broken_models += broken || bad;
  struct model_name *name = calloc(1, sizeof *name);
  if (!name)
    return lod_fail_memory(check->problem);
  snprintf(name->id, sizeof name->id, "%s", row->id);
  name->whole = !broken && !bad;
  name->next = check->models;
  check->models = name;
  return LOD_OK;
}

static enum lod_status check_job(void *context, const struct lod_catalog_job *row) {
  struct check *check = context;
  char name[32];
  snprintf(name, sizeof name, "%" PRIu64, row->number);
  if (row->state != LOD_JOB_QUEUED && row->state != LOD_JOB_RUNNING)
    return LOD_OK;
  if (faccessat(check->uploads_fd, name, F_OK, AT_SYMLINK_NOFOLLOW) == 0)
    return LOD_OK;
  check->findings->lost_uploads++;
  tell(check, "job %s (model %s) waits for an upload that is gone", name, row->id);
  return LOD_OK;
}

static enum lod_status drop_broken(struct check *check) {
  for (const struct model_name *name = check->models; name; name = name->next) {
    bool existed;
    if (name->whole)
      continue;
    LOD_TRY(lod_catalog_delete_model(check->catalog, name->id, NULL, &existed, check->problem));
    tell(check, "model %s: removed from the catalogue", name->id);
    check->findings->repaired++;
  }
  return LOD_OK;
}

/* ---- answers ---- */

/* Models that `repair` has removed are not there. */
static bool is_there(const struct check *check, const char *id) {
  const struct model_name *name = check->models;
  while (name && strcmp(name->id, id) != 0)
    name = name->next;
  return name && (name->whole || !check->repair);
}

static void check_refined(struct check *check) {
  int fd = openat(check->directory_fd, "refined", O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  if (fd < 0)
    return; /* of a daemon that never kept any */
  struct lod_name_list names = lod_list_folder(fd);
  for (size_t i = 0; i < names.count; i++) {
    const char *id, *wrong = lod_answer_judge(fd, names.names[i], &id);
    const bool stray = !*wrong && !is_there(check, id);
    check->findings->refined++;
    if (!*wrong && !stray)
      continue;
    *(stray ? &check->findings->refined_stray : &check->findings->refined_damaged) += 1;
    tell(check, "file refined/%.120s is %s%s", names.names[i], stray ? "of a model that is not there" : wrong,
         check->repair ? ": removed" : "");
    if (check->repair) {
      lod_remove_tree(fd, names.names[i]);
      check->findings->repaired++;
    }
  }
  lod_name_list_finish(&names);
  close(fd);
}

/* ---- all ---- */

static enum lod_status open_all(struct check *check, const char *directory) {
  struct lod_problem *problem = check->problem;
  char path[4096];
  check->directory_fd = open(directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (check->directory_fd < 0)
    return lod_fail(problem, LOD_IO, "store-missing", "'%.200s' is not a store: %s.", directory, strerror(errno));
  if (faccessat(check->directory_fd, "catalog.sqlite", R_OK, 0) != 0)
    return lod_fail(problem, LOD_IO, "store-missing", "'%.200s' is not a store: it has no catalog.sqlite.", directory);
  check->lock_fd = openat(check->directory_fd, "lock", O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0644);
  if (check->lock_fd < 0)
    return lod_fail_errno(problem, "The store's lock cannot be opened");
  if (flock(check->lock_fd, LOCK_EX | LOCK_NB) != 0)
    return lod_fail(problem, LOD_IO, "store-locked", "The store %.200s is in use: stop the daemon first.", directory);
  check->objects_fd = openat(check->directory_fd, "objects", O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  check->uploads_fd = openat(check->directory_fd, "uploads", O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  if (check->objects_fd < 0 || check->uploads_fd < 0)
    return lod_fail_errno(problem, "A folder of the store cannot be opened");
  snprintf(path, sizeof path, "%s/catalog.sqlite", directory);
  LOD_TRY(lod_catalog_open(path, &check->catalog, problem));
  return lod_catalog_check_whole(check->catalog, problem);
}

static enum lod_status run(struct check *check, const char *directory) {
  struct lod_problem *problem = check->problem;
  LOD_TRY(open_all(check, directory));
  LOD_TRY(lod_catalog_read_objects(check->catalog, hold_object, check, problem));
  check_objects(check);
  LOD_TRY(lod_catalog_read_models(check->catalog, check_model, check, problem));
  LOD_TRY(lod_catalog_read_jobs(check->catalog, check_job, check, problem));
  if (check->repair && check->findings->broken_models) { /* what only they named is stray now */
    struct lod_store_findings found = *check->findings;
    LOD_TRY(drop_broken(check));
    found.repaired = check->findings->repaired;
    forget_objects(check);
    LOD_TRY(lod_catalog_read_objects(check->catalog, hold_object, check, problem));
    *check->findings = found;
  }
  check_strays(check);
  check_refined(check);
  return LOD_OK;
}

enum lod_status lod_store_check(const char *directory, bool repair, FILE *out, struct lod_store_findings *findings,
                                struct lod_problem *problem) {
  *findings = (struct lod_store_findings){0};
  struct check check = {.directory_fd = -1,
                        .objects_fd = -1,
                        .uploads_fd = -1,
                        .lock_fd = -1,
                        .repair = repair,
                        .out = out,
                        .findings = findings,
                        .problem = problem,
                        .buffer = malloc(CHUNK)};
  enum lod_status status = check.buffer ? run(&check, directory) : lod_fail_memory(problem);
  forget_objects(&check);
  while (check.models) {
    struct model_name *next = check.models->next;
    free(check.models);
    check.models = next;
  }
  lod_catalog_close(check.catalog);
  const int fds[] = {check.uploads_fd, check.objects_fd, check.directory_fd, check.lock_fd};
  for (size_t i = 0; i < sizeof fds / sizeof *fds; i++)
    if (fds[i] >= 0)
      close(fds[i]);
  free(check.buffer);
  return status;
}

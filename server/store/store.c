#include "server/store/store.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

#include "server/store/answers.h"
#include "server/store/catalog.h"
#include "server/store/files.h"
#include "server/store/intake.h"
#include "server/store/manifest.h"
#include "server/store/objects.h"
#include "server/store/table.h"

struct revision {
  struct lod_stored_model model; /* what readers get; first, so that a reader's pointer is the revision's */
  struct lod_store *store;
  atomic_size_t count;
  struct lod_manifest *manifest;     /* holds the texts and families of `model` */
  struct lod_object_entry **entries; /* one name on each of the manifest's objects */
  size_t entry_count;
};

struct lod_store {
  int directory_fd, lock_fd;
  struct lod_catalog *catalog;
  struct lod_objects *objects;
  struct lod_answers *answers;
  pthread_mutex_t write; /* one writer at a time: commit, delete, reap. Taken before every other lock */

  pthread_rwlock_t snapshot; /* guards the next four */
  struct lod_table models;   /* id -> revision */
  struct revision **order;   /* the same in id order */
  size_t count, capacity;
  _Atomic uint64_t generation, quota;

  /* Unlinks what late readers let go: a reader may be an event thread, which must not wait for the disk. */
  pthread_t reaper;
  bool reaper_runs;
  pthread_mutex_t reap_mutex;
  pthread_cond_t reap_wake;
  bool reap_wanted, closing;
};

/* ---- revisions ---- */

static double now(void) {
  struct timespec time;
  clock_gettime(CLOCK_REALTIME, &time);
  return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

/* Takes the manifest in any case, and on LOD_OK one name on each entry. */
static enum lod_status create_revision(struct lod_store *store, struct lod_manifest *manifest, double created,
                                       struct lod_object_entry **entries, struct revision **revision, struct lod_problem *problem) {
  struct revision *result = calloc(1, sizeof *result);
  *revision = result;
  if (result == NULL) {
    lod_manifest_destroy(manifest);
    return lod_fail_memory(problem);
  }
  atomic_init(&result->count, 1);
  result->store = store;
  result->manifest = manifest;
  result->entries = entries;
  result->entry_count = manifest->object_count;
  struct lod_stored_model *model = &result->model;
  model->id = manifest->id;
  model->revision = manifest->revision;
  model->manifest = manifest->text;
  model->manifest_size = manifest->size;
  char digest[LOD_SHA256_HEX + 1];
  lod_sha256_text(manifest->text, manifest->size, digest);
  snprintf(model->manifest_etag, sizeof model->manifest_etag, "\"%s\"", digest);
  model->created = created;
  for (size_t i = 0; i < result->entry_count; i++)
    model->bytes += lod_object_entry_bytes(entries[i]);
  model->triangles = manifest->triangles;
  model->diagonal = manifest->diagonal;
  model->family_count = manifest->family_count;
  model->families = manifest->families;
  memcpy(model->tileset, manifest->tileset, sizeof model->tileset);
  memcpy(model->gltf, manifest->gltf, sizeof model->gltf);
  return LOD_OK;
}

static void unname_all(struct lod_store *store, struct lod_object_entry **entries, size_t count) {
  for (size_t i = 0; i < count; i++)
    lod_objects_unname(store->objects, entries[i]);
  free(entries);
}

void lod_store_model_release(struct lod_stored_model *model) {
  struct revision *revision = (struct revision *)model;
  if (revision == NULL || atomic_fetch_sub_explicit(&revision->count, 1, memory_order_acq_rel) != 1)
    return;
  unname_all(revision->store, revision->entries, revision->entry_count);
  lod_manifest_destroy(revision->manifest);
  free(revision);
}

/* ---- the snapshot of all models ---- */

/* First place in id order whose id is greater than `id`, or not less when `or_equal`. */
static size_t lower_bound(const struct lod_store *store, const char *id, bool or_equal) {
  size_t low = 0, high = store->count;
  while (low < high) {
    size_t middle = low + (high - low) / 2;
    int order = strcmp(store->order[middle]->model.id, id);
    if (order < 0 || (order == 0 && !or_equal))
      low = middle + 1;
    else
      high = middle;
  }
  return low;
}

/* Room for one more, so that nothing can fail after the transaction. The writer lock is held. */
static enum lod_status reserve_snapshot(struct lod_store *store, struct lod_problem *problem) {
  enum lod_status status = LOD_OK;
  pthread_rwlock_wrlock(&store->snapshot);
  if (!lod_table_reserve(&store->models))
    status = lod_fail_memory(problem);
  if (status == LOD_OK && store->count == store->capacity) {
    size_t capacity = store->capacity == 0 ? 64 : store->capacity * 2;
    struct revision **order = reallocarray(store->order, capacity, sizeof *order);
    if (order == NULL) {
      status = lod_fail_memory(problem);
    } else {
      store->order = order;
      store->capacity = capacity;
    }
  }
  pthread_rwlock_unlock(&store->snapshot);
  return status;
}

/* Puts `revision` (NULL: nothing) in the place of what `id` was; returns that. */
static struct revision *exchange(struct lod_store *store, const char *id, struct revision *revision) {
  pthread_rwlock_wrlock(&store->snapshot);
  struct revision *old = lod_table_remove(&store->models, id);
  size_t place = lower_bound(store, id, true);
  struct revision **slot = store->order == NULL ? NULL : store->order + place; /* NULL: nothing to take out and nothing put in */
  if (revision != NULL)
    lod_table_insert(&store->models, revision->model.id, revision);
  if (old != NULL && revision != NULL) {
    *slot = revision;
  } else if (revision != NULL) {
    memmove(slot + 1, slot, (store->count - place) * sizeof *slot);
    *slot = revision;
    store->count++;
  } else if (old != NULL) {
    store->count--;
    memmove(slot, slot + 1, (store->count - place) * sizeof *slot);
  }
  atomic_fetch_add(&store->generation, 1);
  pthread_rwlock_unlock(&store->snapshot);
  return old;
}

struct lod_stored_model *lod_store_model_open(struct lod_store *store, const char *id) {
  pthread_rwlock_rdlock(&store->snapshot);
  struct revision *revision = lod_table_find(&store->models, id);
  if (revision != NULL)
    atomic_fetch_add_explicit(&revision->count, 1, memory_order_relaxed);
  pthread_rwlock_unlock(&store->snapshot);
  return revision == NULL ? NULL : &revision->model;
}

size_t lod_store_model_list(struct lod_store *store, const char *after, size_t limit, struct lod_stored_model **models) {
  pthread_rwlock_rdlock(&store->snapshot);
  size_t filled = 0;
  for (size_t i = after == NULL ? 0 : lower_bound(store, after, false); i < store->count && filled < limit; i++) {
    atomic_fetch_add_explicit(&store->order[i]->count, 1, memory_order_relaxed);
    models[filled++] = &store->order[i]->model;
  }
  pthread_rwlock_unlock(&store->snapshot);
  return filled;
}

size_t lod_store_model_count(struct lod_store *store) {
  pthread_rwlock_rdlock(&store->snapshot);
  size_t count = store->count;
  pthread_rwlock_unlock(&store->snapshot);
  return count;
}

uint64_t lod_store_generation(struct lod_store *store) {
  return atomic_load(&store->generation);
}
void lod_store_set_quota(struct lod_store *store, uint64_t bytes) {
  atomic_store(&store->quota, bytes);
}
uint64_t lod_store_bytes(struct lod_store *store) {
  return lod_objects_bytes(store->objects);
}

bool lod_model_id_valid(const char *id) {
  if (id == NULL || id[0] == '.' || id[0] == '-')
    return false;
  size_t length = strspn(id, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-");
  return length >= 1 && length <= LOD_MODEL_ID_MAX && id[length] == 0;
}

/* ---- objects ---- */

enum lod_status lod_store_object_open(struct lod_store *store, const char *sha256, struct lod_object **object,
                                      struct lod_problem *problem) {
  return lod_objects_open(store->objects, sha256, object, problem);
}

/* ---- answers ---- */

struct lod_answers *lod_store_answers(struct lod_store *store) {
  return store->answers;
}

/* Under the snapshot's lock: either the revision is still the model's and what is kept now is forgotten with it, or nothing is kept. */
void lod_store_keep_answer(struct lod_store *store, const char *id, const char *revision, const char *key, const uint8_t *bytes,
                           size_t size, const char *facts, void *held, void (*release)(void *held)) {
  pthread_rwlock_rdlock(&store->snapshot);
  const struct revision *now_there = lod_table_find(&store->models, id);
  bool same = now_there != NULL && strcmp(now_there->model.revision, revision) == 0;
  if (same)
    lod_answers_keep(store->answers, id, key, bytes, size, facts, held, release);
  pthread_rwlock_unlock(&store->snapshot);
  if (!same)
    release(held);
}

static bool model_is_there(void *context, const char *id) {
  struct lod_store *store = context;
  return lod_table_find(&store->models, id) != NULL;
}

static void want_reap(void *context) {
  struct lod_store *store = context;
  pthread_mutex_lock(&store->reap_mutex);
  store->reap_wanted = true;
  pthread_cond_signal(&store->reap_wake);
  pthread_mutex_unlock(&store->reap_mutex);
}

static void *reap(void *argument) {
  struct lod_store *store = argument;
  pthread_mutex_lock(&store->reap_mutex);
  while (!store->closing) {
    if (!store->reap_wanted) {
      pthread_cond_wait(&store->reap_wake, &store->reap_mutex);
      continue;
    }
    store->reap_wanted = false;
    pthread_mutex_unlock(&store->reap_mutex);
    pthread_mutex_lock(&store->write);
    lod_objects_reap(store->objects);
    pthread_mutex_unlock(&store->write);
    pthread_mutex_lock(&store->reap_mutex);
  }
  pthread_mutex_unlock(&store->reap_mutex);
  return NULL;
}

/* ---- commit and delete ---- */

/* Moves the checked objects in and names them; on failure none is named. */
static enum lod_status adopt_all(struct lod_store *store, const struct lod_manifest *manifest, int objects_fd,
                                 struct lod_object_entry ***entries, struct lod_problem *problem) {
  struct lod_object_entry **list = calloc(manifest->object_count, sizeof *list);
  if (list == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = LOD_OK;
  size_t count = 0;
  while (status == LOD_OK && count < manifest->object_count) {
    const struct lod_manifest_object *object = &manifest->objects[count];
    status = lod_objects_adopt(store->objects, objects_fd, object->sha256, object->type, object->bytes, &list[count], problem);
    count += status == LOD_OK;
  }
  if (status == LOD_OK)
    status = lod_objects_sync(store->objects, list, count, problem);
  if (status != LOD_OK) {
    unname_all(store, list, count);
    return status;
  }
  *entries = list;
  return LOD_OK;
}

static enum lod_status write_rows(struct lod_store *store, const struct revision *revision, struct lod_problem *problem) {
  const struct lod_manifest *manifest = revision->manifest;
  struct lod_catalog_object *objects = calloc(manifest->object_count, sizeof *objects);
  if (objects == NULL)
    return lod_fail_memory(problem);
  for (size_t i = 0; i < manifest->object_count; i++) {
    const struct lod_manifest_object *object = &manifest->objects[i];
    objects[i] = (struct lod_catalog_object){object->sha256, object->type, object->bytes};
  }
  const struct lod_catalog_model row = {.id = manifest->id,
                                        .revision = manifest->revision,
                                        .manifest = manifest->text,
                                        .manifest_size = manifest->size,
                                        .object_count = manifest->object_count,
                                        .created = revision->model.created,
                                        .objects = objects};
  enum lod_status status = lod_catalog_put_model(store->catalog, &row, atomic_load(&store->quota), problem);
  free(objects);
  return status;
}

/* The writer lock is held. Takes the manifest. */
static enum lod_status commit(struct lod_store *store, struct lod_manifest *manifest, int objects_fd, struct lod_problem *problem) {
  struct lod_object_entry **entries = NULL;
  enum lod_status status = reserve_snapshot(store, problem);
  if (status == LOD_OK)
    status = adopt_all(store, manifest, objects_fd, &entries, problem);
  if (status != LOD_OK) {
    lod_manifest_destroy(manifest);
    return status;
  }
  size_t count = manifest->object_count;
  struct revision *revision;
  status = create_revision(store, manifest, now(), entries, &revision, problem);
  if (status != LOD_OK) {
    unname_all(store, entries, count);
    return status;
  }
  struct lod_problem local = {0};
  status = write_rows(store, revision, &local);
  struct revision *gone = status == LOD_OK ? exchange(store, revision->model.id, revision) : revision;
  if (status != LOD_OK) {
    (void)lod_fail(problem, status, local.type, "%s", local.detail);
    /* When the sync itself failed, the rows may yet turn up after a crash. Then the files must be there: they keep a name until the next
     * start, which removes what the catalogue does not have. */
    for (size_t i = 0; strcmp(local.type, "store-error") == 0 && i < count; i++)
      (void)lod_objects_name(store->objects, lod_object_entry_sha256(entries[i]));
  }
  if (status == LOD_OK)
    lod_answers_forget(store->answers, revision->model.id);
  if (gone != NULL)
    lod_store_model_release(&gone->model);
  return status;
}

enum lod_status lod_store_commit_bake(struct lod_store *store, const char *id, int directory_fd, struct lod_problem *problem) {
  if (!lod_model_id_valid(id))
    return lod_fail(problem, LOD_BAD_INPUT, "bad-id",
                    "A model's id is 1 to %d of A-Z, a-z, 0-9, dot, underscore and dash, and begins with none of '.-'.", LOD_MODEL_ID_MAX);
  struct lod_manifest *manifest;
  int objects_fd;
  LOD_TRY(lod_intake_check(directory_fd, id, &manifest, &objects_fd, problem));
  pthread_mutex_lock(&store->write);
  enum lod_status status = commit(store, manifest, objects_fd, problem);
  lod_objects_reap(store->objects);
  pthread_mutex_unlock(&store->write);
  close(objects_fd);
  return status;
}

/* With less than this a job cannot even be queued. */
enum { READY_FREE_BYTES = 256 * 1024 };

/* Space that is given up when a delete meets a full disk: a delete must be able to write its few pages, or nothing could ever free space.
 */
enum { RESERVE_BYTES = 512 * 1024 };

static void make_reserve(struct lod_store *store) {
  int fd = openat(store->directory_fd, "reserve", O_WRONLY | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (fd < 0)
    return;
  (void)posix_fallocate(fd, 0, RESERVE_BYTES); /* without it a full disk must be cleared by hand; everything else works */
  close(fd);
}

static enum lod_status delete_rows(struct lod_store *store, const char *id, const struct lod_catalog_ending *ending, bool *existed,
                                   struct lod_problem *problem) {
  struct lod_problem local = {0};
  enum lod_status status = lod_catalog_delete_model(store->catalog, id, ending, existed, &local);
  if (status == LOD_IO && strcmp(local.type, "disk-full") == 0 && unlinkat(store->directory_fd, "reserve", 0) == 0) {
    local = (struct lod_problem){0};
    status = lod_catalog_delete_model(store->catalog, id, ending, existed, &local);
  }
  return status == LOD_OK ? LOD_OK : lod_fail(problem, status, local.type, "%s", local.detail);
}

enum lod_status lod_store_model_delete(struct lod_store *store, const char *id, const struct lod_catalog_ending *ending, bool *existed,
                                       struct lod_problem *problem) {
  pthread_mutex_lock(&store->write);
  enum lod_status status = delete_rows(store, id, ending, existed, problem);
  if (status == LOD_OK) {
    struct revision *old = exchange(store, id, NULL);
    if (old != NULL)
      lod_store_model_release(&old->model);
    lod_answers_forget(store->answers, id);
    lod_objects_reap(store->objects);
    make_reserve(store);
  }
  pthread_mutex_unlock(&store->write);
  return status;
}

/* ---- open and close ---- */

struct load {
  struct lod_store *store;
  struct lod_problem *problem;
};

static enum lod_status load_object(void *context, const struct lod_catalog_object *object) {
  const struct load *load = context;
  const char *type = lod_manifest_media_type(object->type);
  return lod_objects_add(load->store->objects, object->sha256, type == NULL ? "application/octet-stream" : type, object->bytes,
                         load->problem);
}

static enum lod_status load_model(void *context, const struct lod_catalog_model *row) {
  const struct load *load = context;
  struct lod_store *store = load->store;
  struct lod_manifest *manifest;
  struct lod_problem problem = {0};
  enum lod_status status = lod_manifest_parse(row->manifest, row->manifest_size, row->id, &manifest, &problem);
  if (status == LOD_MEMORY)
    return lod_fail_memory(load->problem);
  if (status != LOD_OK) {
    fprintf(stderr, "lodestreamd: model %s is left out, its manifest is damaged: %s\n", row->id, problem.detail);
    return LOD_OK; /* one damaged row must not take all others down; its objects stay */
  }
  struct lod_object_entry **entries = calloc(manifest->object_count, sizeof *entries);
  size_t count = 0;
  while (entries != NULL && count < manifest->object_count &&
         (entries[count] = lod_objects_name(store->objects, manifest->objects[count].sha256)) != NULL)
    count++;
  if (entries == NULL || count < manifest->object_count) {
    if (entries != NULL)
      fprintf(stderr, "lodestreamd: model %s is left out, the catalogue lacks its object %.12s\n", row->id,
              manifest->objects[count].sha256);
    unname_all(store, entries, count);
    lod_manifest_destroy(manifest);
    return entries == NULL ? lod_fail_memory(load->problem) : LOD_OK;
  }
  struct revision *revision;
  status = create_revision(store, manifest, row->created, entries, &revision, load->problem);
  if (status != LOD_OK)
    unname_all(store, entries, count);
  if (status == LOD_OK)
    status = reserve_snapshot(store, load->problem);
  if (status == LOD_OK)
    exchange(store, row->id, revision);
  else if (revision != NULL)
    lod_store_model_release(&revision->model);
  return status;
}

/* A daemon that was killed may leave a worker between fork and exec, which holds the lock for that moment: it is waited for. */
static int lock_patiently(int fd) {
  enum { TRIES = 150 };
  for (int i = 0; i < TRIES; i++) {
    if (flock(fd, LOCK_EX | LOCK_NB) == 0)
      return 0;
    if (errno != EWOULDBLOCK && errno != EINTR)
      return -1;
    nanosleep(&(struct timespec){.tv_nsec = 20000000}, NULL);
  }
  errno = EWOULDBLOCK;
  return -1;
}

static enum lod_status open_folder(struct lod_store *store, const char *directory, struct lod_problem *problem) {
  if (mkdir(directory, 0755) != 0 && errno != EEXIST)
    return lod_fail_errno(problem, "The store's directory cannot be made");
  store->directory_fd = open(directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (store->directory_fd < 0)
    return lod_fail_errno(problem, "The store's directory cannot be opened");
  store->lock_fd = openat(store->directory_fd, "lock", O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0644);
  if (store->lock_fd < 0)
    return lod_fail_errno(problem, "The store's lock cannot be made");
  if (lock_patiently(store->lock_fd) != 0)
    return errno == EWOULDBLOCK ? lod_fail(problem, LOD_IO, "store-locked", "The store %s is in use by another process.", directory)
                                : lod_fail_errno(problem, "The store cannot be locked");
  static const char *const kFolders[] = {"uploads", "work"};
  for (size_t i = 0; i < sizeof kFolders / sizeof kFolders[0]; i++)
    if (mkdirat(store->directory_fd, kFolders[i], 0700) != 0 && errno != EEXIST)
      return lod_fail_errno(problem, "A folder of the store cannot be made");
  return fsync(store->directory_fd) == 0 ? LOD_OK : lod_fail_errno(problem, "The store's directory cannot be synced");
}

static enum lod_status open_store(struct lod_store *store, const char *directory, struct lod_problem *problem) {
  char path[4096];
  LOD_TRY(open_folder(store, directory, problem));
  if (snprintf(path, sizeof path, "%s/catalog.sqlite", directory) >= (int)sizeof path)
    return lod_fail(problem, LOD_BAD_INPUT, "store-path", "The path of the store is too long.");
  LOD_TRY(lod_catalog_open(path, &store->catalog, problem));
  LOD_TRY(lod_objects_create(store->directory_fd, want_reap, store, &store->objects, problem));
  struct load load = {store, problem};
  LOD_TRY(lod_catalog_read_objects(store->catalog, load_object, &load, problem));
  LOD_TRY(lod_catalog_read_models(store->catalog, load_model, &load, problem));
  size_t missing;
  LOD_TRY(lod_objects_sweep(store->objects, &missing, problem));
  if (missing > 0)
    fprintf(stderr, "lodestreamd: %zu objects of the store are missing or cut short; their models must be baked again\n", missing);
  lod_empty_folder(store->directory_fd, "work");
  LOD_TRY(lod_answers_open(store->directory_fd, &store->answers, problem));
  lod_answers_sweep(store->answers, model_is_there, store);
  make_reserve(store);
  store->reaper_runs = pthread_create(&store->reaper, NULL, reap, store) == 0;
  return store->reaper_runs ? LOD_OK : lod_fail_memory(problem);
}

enum lod_status lod_store_open(const char *directory, struct lod_store **store, struct lod_problem *problem) {
  *store = NULL;
  struct lod_store *result = calloc(1, sizeof *result);
  if (result == NULL)
    return lod_fail_memory(problem);
  result->directory_fd = result->lock_fd = -1;
  pthread_mutex_init(&result->write, NULL);
  pthread_mutex_init(&result->reap_mutex, NULL);
  pthread_cond_init(&result->reap_wake, NULL);
  pthread_rwlock_init(&result->snapshot, NULL);
  enum lod_status status = open_store(result, directory, problem);
  if (status != LOD_OK) {
    lod_store_close(result);
    return status;
  }
  *store = result;
  return LOD_OK;
}

void lod_store_close(struct lod_store *store) {
  if (store == NULL)
    return;
  if (store->reaper_runs) {
    pthread_mutex_lock(&store->reap_mutex);
    store->closing = true;
    pthread_cond_signal(&store->reap_wake);
    pthread_mutex_unlock(&store->reap_mutex);
    pthread_join(store->reaper, NULL);
    lod_objects_reap(store->objects); /* what was let go last */
  }
  lod_answers_close(store->answers);
  /* From here on releasing a revision means forgetting it: names go, files stay, nothing reaps. */
  for (size_t i = 0; i < store->count; i++) {
    assert(atomic_load(&store->order[i]->count) == 1); /* else a reader still holds a model */
    lod_store_model_release(&store->order[i]->model);
  }
  free(store->order);
  lod_table_finish(&store->models);
  lod_objects_destroy(store->objects);
  lod_catalog_close(store->catalog);
  if (store->lock_fd >= 0)
    close(store->lock_fd);
  if (store->directory_fd >= 0)
    close(store->directory_fd);
  pthread_rwlock_destroy(&store->snapshot);
  pthread_cond_destroy(&store->reap_wake);
  pthread_mutex_destroy(&store->reap_mutex);
  pthread_mutex_destroy(&store->write);
  free(store);
}

/* Writes, because what statvfs says is not the whole truth: of a quota, or of a file system that went read-only by an error. */
static bool can_write(const struct lod_store *store) {
  static const char kPage[4096];
  int fd = openat(store->directory_fd, "uploads", O_TMPFILE | O_WRONLY | O_CLOEXEC, 0600);
  if (fd < 0)
    return errno == EOPNOTSUPP || errno == EISDIR || errno == EINVAL; /* a file system without unnamed files: it cannot be told */
  bool written = write(fd, kPage, sizeof kPage) == (ssize_t)sizeof kPage;
  int error = errno;
  close(fd);
  errno = error;
  return written;
}

bool lod_store_ready(struct lod_store *store, struct lod_problem *problem) {
  if (lod_catalog_check(store->catalog, problem) != LOD_OK)
    return false;
  struct statvfs facts;
  if (fstatvfs(store->directory_fd, &facts) != 0 || faccessat(store->directory_fd, "uploads", W_OK | X_OK, AT_EACCESS) != 0) {
    (void)lod_fail_errno(problem, "The store's directory cannot be written");
    return false;
  }
  if ((facts.f_flag & ST_RDONLY) != 0) {
    (void)lod_fail(problem, LOD_IO, "store-read-only", "The store's file system is mounted read-only.");
    return false;
  }
  if ((uint64_t)facts.f_bavail * facts.f_frsize < READY_FREE_BYTES) {
    (void)lod_fail(problem, LOD_IO, "disk-full", "The store's file system has less than %d KiB left.", READY_FREE_BYTES / 1024);
    return false;
  }
  if (!can_write(store)) {
    (void)lod_fail_errno(problem, "The store's directory cannot be written");
    return false;
  }
  return true;
}

struct lod_catalog *lod_store_catalog(struct lod_store *store) {
  return store->catalog;
}
int lod_store_directory_fd(struct lod_store *store) {
  return store->directory_fd;
}

#include "server/store/objects.h"

#include <assert.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/store/files.h"
#include "server/store/table.h"

/* Mappings that nobody holds stay for the next reader, up to this many: a mapping costs a system call and page faults to make again. The
 * kernel allows some 65 000 per process. Those of larger objects hold a descriptor too. */
enum { IDLE_MAPPINGS = 2048, FOLDERS = 256 };

struct mapping {
  struct lod_object object; /* what readers get; first, so that a reader's pointer is the mapping's */
  struct lod_objects *objects;
  struct lod_object_entry *entry; /* NULL: the object is gone, only readers are left */
  size_t readers;
  struct mapping *older, *newer; /* in the idle list, while readers == 0 */
};

struct lod_object_entry {
  char sha256[LOD_SHA256_HEX + 1];
  const char *type;
  uint64_t bytes;
  size_t names;
  struct mapping *mapping; /* NULL: not mapped */
  bool doomed;             /* in the doomed list */
  struct lod_object_entry *next_doomed;
};

struct lod_objects {
  int folder_fd; /* objects/ */
  void (*doomed)(void *context);
  void *context;
  pthread_mutex_t mutex; /* guards all below */
  struct lod_table entries;
  uint64_t bytes; /* of all entries */
  struct lod_object_entry *doomed_list;
  struct mapping *idle_oldest, *idle_newest;
  size_t idle_count, mapping_count;
};

/* "ab/<sha256>" */
struct path {
  char text[3 + LOD_SHA256_HEX + 1];
};
static struct path object_path(const char *sha256) {
  struct path path;
  snprintf(path.text, sizeof path.text, "%.2s/%.64s", sha256, sha256);
  return path;
}

/* ---- mappings; the mutex is held ---- */

static void idle_remove(struct lod_objects *objects, struct mapping *mapping) {
  *(mapping->older != NULL ? &mapping->older->newer : &objects->idle_oldest) = mapping->newer;
  *(mapping->newer != NULL ? &mapping->newer->older : &objects->idle_newest) = mapping->older;
  mapping->older = mapping->newer = NULL;
  objects->idle_count--;
}

static void idle_add(struct lod_objects *objects, struct mapping *mapping) {
  mapping->older = objects->idle_newest;
  mapping->newer = NULL;
  *(mapping->older != NULL ? &mapping->older->newer : &objects->idle_oldest) = mapping;
  objects->idle_newest = mapping;
  objects->idle_count++;
}

static void unmap(struct lod_objects *objects, struct mapping *mapping) {
  if (mapping->entry != NULL)
    mapping->entry->mapping = NULL;
  munmap((void *)mapping->object.bytes, mapping->object.size);
  if (mapping->object.file >= 0)
    close(mapping->object.file);
  objects->mapping_count--;
  free(mapping);
}

static struct mapping *map(struct lod_objects *objects, struct lod_object_entry *entry, struct lod_problem *problem) {
  int fd = openat(objects->folder_fd, object_path(entry->sha256).text, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
  struct stat facts;
  if (fd < 0 || fstat(fd, &facts) != 0 || (uint64_t)facts.st_size != entry->bytes) {
    (void)lod_fail(problem, LOD_IO, "object-missing", "The file of object %.12s is missing or damaged (%s). Bake its models again.",
                   entry->sha256, fd < 0 ? strerror(errno) : "wrong size");
    if (fd >= 0)
      close(fd);
    return NULL;
  }
  void *bytes = mmap(NULL, entry->bytes, PROT_READ, MAP_SHARED, fd, 0);
  if (entry->bytes < LOD_OBJECT_FILE_BYTES) {
    close(fd);
    fd = -1;
  }
  struct mapping *mapping = bytes == MAP_FAILED ? NULL : calloc(1, sizeof *mapping);
  if (mapping == NULL) {
    if (bytes != MAP_FAILED)
      munmap(bytes, entry->bytes);
    if (fd >= 0)
      close(fd);
    (void)lod_fail_memory(problem);
    return NULL;
  }
  memcpy(mapping->object.sha256, entry->sha256, sizeof entry->sha256);
  mapping->object.type = entry->type;
  mapping->object.bytes = bytes;
  mapping->object.size = entry->bytes;
  mapping->object.file = fd;
  mapping->objects = objects;
  mapping->entry = entry;
  entry->mapping = mapping;
  objects->mapping_count++;
  idle_add(objects, mapping);
  return mapping;
}

enum lod_status lod_objects_open(struct lod_objects *objects, const char *sha256, struct lod_object **object, struct lod_problem *problem) {
  *object = NULL;
  enum lod_status status = LOD_OK;
  pthread_mutex_lock(&objects->mutex);
  struct lod_object_entry *entry = lod_table_find(&objects->entries, sha256);
  if (entry != NULL && entry->names > 0) {
    struct mapping *mapping = entry->mapping;
    if (mapping == NULL)
      mapping = map(objects, entry, problem);
    if (mapping == NULL) {
      status = problem != NULL && problem->status == LOD_MEMORY ? LOD_MEMORY : LOD_IO;
    } else {
      if (mapping->readers++ == 0)
        idle_remove(objects, mapping);
      *object = &mapping->object;
    }
  }
  pthread_mutex_unlock(&objects->mutex);
  return status;
}

void lod_store_object_release(struct lod_object *object) {
  if (object == NULL)
    return;
  struct mapping *mapping = (struct mapping *)object;
  struct lod_objects *objects = mapping->objects;
  pthread_mutex_lock(&objects->mutex);
  assert(mapping->readers > 0);
  if (--mapping->readers == 0) {
    if (mapping->entry == NULL) {
      unmap(objects, mapping);
    } else {
      idle_add(objects, mapping);
      if (objects->idle_count > IDLE_MAPPINGS) {
        struct mapping *oldest = objects->idle_oldest;
        idle_remove(objects, oldest);
        unmap(objects, oldest);
      }
    }
  }
  pthread_mutex_unlock(&objects->mutex);
}

/* ---- entries ---- */

static enum lod_status make_folders(struct lod_objects *objects, int directory_fd, struct lod_problem *problem) {
  if (mkdirat(directory_fd, "objects", 0755) != 0 && errno != EEXIST)
    return lod_fail_errno(problem, "The folder objects cannot be made");
  objects->folder_fd = openat(directory_fd, "objects", O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  if (objects->folder_fd < 0)
    return lod_fail_errno(problem, "The folder objects cannot be opened");
  bool made = false;
  for (int i = 0; i < FOLDERS; i++) {
    char name[3];
    snprintf(name, sizeof name, "%02x", i);
    if (mkdirat(objects->folder_fd, name, 0755) == 0)
      made = true;
    else if (errno != EEXIST)
      return lod_fail_errno(problem, "The folders beneath objects cannot be made");
  }
  if (made && (fsync(objects->folder_fd) != 0 || fsync(directory_fd) != 0))
    return lod_fail_errno(problem, "The folder objects cannot be synced");
  return LOD_OK;
}

enum lod_status lod_objects_create(int directory_fd, void (*doomed)(void *context), void *context, struct lod_objects **objects,
                                   struct lod_problem *problem) {
  *objects = NULL;
  struct lod_objects *result = calloc(1, sizeof *result);
  if (result == NULL)
    return lod_fail_memory(problem);
  result->folder_fd = -1;
  result->doomed = doomed;
  result->context = context;
  pthread_mutex_init(&result->mutex, NULL);
  enum lod_status status = make_folders(result, directory_fd, problem);
  if (status != LOD_OK) {
    lod_objects_destroy(result);
    return status;
  }
  *objects = result;
  return LOD_OK;
}

void lod_objects_destroy(struct lod_objects *objects) {
  if (objects == NULL)
    return;
  while (objects->idle_oldest != NULL) {
    struct mapping *oldest = objects->idle_oldest;
    idle_remove(objects, oldest);
    unmap(objects, oldest);
  }
  assert(objects->mapping_count == 0); /* else a reader still holds an object */
  size_t position = 0;
  for (struct lod_object_entry *entry; (entry = lod_table_next(&objects->entries, &position)) != NULL;)
    free(entry);
  lod_table_finish(&objects->entries);
  if (objects->folder_fd >= 0)
    close(objects->folder_fd);
  pthread_mutex_destroy(&objects->mutex);
  free(objects);
}

/* NULL when memory is out. The mutex is held. */
static struct lod_object_entry *insert(struct lod_objects *objects, const char *sha256, const char *type, uint64_t bytes) {
  struct lod_object_entry *entry = calloc(1, sizeof *entry);
  if (entry == NULL || !lod_table_reserve(&objects->entries)) {
    free(entry);
    return NULL;
  }
  snprintf(entry->sha256, sizeof entry->sha256, "%s", sha256);
  entry->type = type;
  entry->bytes = bytes;
  lod_table_insert(&objects->entries, entry->sha256, entry);
  objects->bytes += bytes;
  return entry;
}

enum lod_status lod_objects_add(struct lod_objects *objects, const char *sha256, const char *type, uint64_t bytes,
                                struct lod_problem *problem) {
  pthread_mutex_lock(&objects->mutex);
  struct lod_object_entry *entry = insert(objects, sha256, type, bytes);
  pthread_mutex_unlock(&objects->mutex);
  return entry == NULL ? lod_fail_memory(problem) : LOD_OK;
}

struct lod_object_entry *lod_objects_name(struct lod_objects *objects, const char *sha256) {
  pthread_mutex_lock(&objects->mutex);
  struct lod_object_entry *entry = lod_table_find(&objects->entries, sha256);
  if (entry != NULL)
    entry->names++;
  pthread_mutex_unlock(&objects->mutex);
  return entry;
}

void lod_objects_unname(struct lod_objects *objects, struct lod_object_entry *entry) {
  bool doomed = false;
  pthread_mutex_lock(&objects->mutex);
  assert(entry->names > 0);
  if (--entry->names == 0 && !entry->doomed) {
    entry->doomed = doomed = true;
    entry->next_doomed = objects->doomed_list;
    objects->doomed_list = entry;
  }
  pthread_mutex_unlock(&objects->mutex);
  if (doomed && objects->doomed != NULL)
    objects->doomed(objects->context);
}

uint64_t lod_objects_bytes(struct lod_objects *objects) {
  pthread_mutex_lock(&objects->mutex);
  uint64_t bytes = objects->bytes;
  pthread_mutex_unlock(&objects->mutex);
  return bytes;
}

const char *lod_object_entry_sha256(const struct lod_object_entry *entry) {
  return entry->sha256;
}
uint64_t lod_object_entry_bytes(const struct lod_object_entry *entry) {
  return entry->bytes;
}

static bool file_is_whole(struct lod_objects *objects, const struct lod_object_entry *entry) {
  struct stat facts;
  return fstatat(objects->folder_fd, object_path(entry->sha256).text, &facts, AT_SYMLINK_NOFOLLOW) == 0 && S_ISREG(facts.st_mode) &&
         (uint64_t)facts.st_size == entry->bytes;
}

enum lod_status lod_objects_adopt(struct lod_objects *objects, int source_fd, const char *sha256, const char *type, uint64_t bytes,
                                  struct lod_object_entry **entry, struct lod_problem *problem) {
  *entry = lod_objects_name(objects, sha256);
  if (*entry != NULL && (*entry)->type != type) {
    lod_objects_unname(objects, *entry);
    return lod_fail(problem, LOD_BAD_INPUT, "bad-manifest", "Object %.12s is already stored as %s.", sha256, (*entry)->type);
  }
  if (*entry != NULL && file_is_whole(objects, *entry))
    return LOD_OK;
  bool moved = renameat(source_fd, sha256, objects->folder_fd, object_path(sha256).text) == 0;
  enum lod_status status = moved ? LOD_OK : lod_fail_errno(problem, "An object cannot be moved into the store");
  if (*entry == NULL && moved) {
    pthread_mutex_lock(&objects->mutex);
    *entry = insert(objects, sha256, type, bytes);
    if (*entry != NULL)
      (*entry)->names = 1;
    pthread_mutex_unlock(&objects->mutex);
    if (*entry == NULL) {
      unlinkat(objects->folder_fd, object_path(sha256).text, 0);
      status = lod_fail_memory(problem);
    }
  }
  if (status != LOD_OK && *entry != NULL) {
    lod_objects_unname(objects, *entry);
    *entry = NULL;
  }
  return status;
}

enum lod_status lod_objects_sync(struct lod_objects *objects, struct lod_object_entry *const *entries, size_t count,
                                 struct lod_problem *problem) {
  bool touched[FOLDERS] = {false};
  for (size_t i = 0; i < count; i++)
    touched[lod_hex_byte(entries[i]->sha256)] = true;
  for (int i = 0; i < FOLDERS; i++) {
    char name[3];
    if (!touched[i])
      continue;
    snprintf(name, sizeof name, "%02x", i);
    int fd = openat(objects->folder_fd, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
    bool synced = fd >= 0 && fsync(fd) == 0;
    enum lod_status status = synced ? LOD_OK : lod_fail_errno(problem, "A folder of objects cannot be synced");
    if (fd >= 0)
      close(fd);
    LOD_TRY(status);
  }
  return LOD_OK;
}

void lod_objects_reap(struct lod_objects *objects) {
  pthread_mutex_lock(&objects->mutex);
  struct lod_object_entry *list = objects->doomed_list, *gone = NULL;
  objects->doomed_list = NULL;
  while (list != NULL) {
    struct lod_object_entry *entry = list;
    list = entry->next_doomed;
    entry->doomed = false;
    if (entry->names > 0)
      continue; /* named again meanwhile */
    lod_table_remove(&objects->entries, entry->sha256);
    objects->bytes -= entry->bytes;
    if (entry->mapping != NULL) {
      struct mapping *mapping = entry->mapping;
      mapping->entry = NULL;
      if (mapping->readers == 0) {
        idle_remove(objects, mapping);
        unmap(objects, mapping);
      }
    }
    entry->next_doomed = gone;
    gone = entry;
  }
  pthread_mutex_unlock(&objects->mutex);
  /* Nobody can find them now, and nobody can bring them back before the caller gives up the writer lock. */
  while (gone != NULL) {
    struct lod_object_entry *entry = gone;
    gone = entry->next_doomed;
    unlinkat(objects->folder_fd, object_path(entry->sha256).text, 0);
    free(entry);
  }
}

/* ---- start ---- */

static enum lod_status sweep_folder(struct lod_objects *objects, int index, struct lod_problem *problem) {
  char name[3];
  snprintf(name, sizeof name, "%02x", index);
  int fd = openat(objects->folder_fd, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  DIR *folder = fd < 0 ? NULL : fdopendir(fd);
  if (folder == NULL) {
    enum lod_status status = lod_fail_errno(problem, "A folder of objects cannot be read");
    if (fd >= 0)
      close(fd);
    return status;
  }
  for (const struct dirent *file; (file = readdir(folder)) != NULL;)
    if (strcmp(file->d_name, ".") != 0 && strcmp(file->d_name, "..") != 0 && lod_table_find(&objects->entries, file->d_name) == NULL)
      lod_remove_tree(fd, file->d_name);
  closedir(folder);
  return LOD_OK;
}

enum lod_status lod_objects_sweep(struct lod_objects *objects, size_t *missing, struct lod_problem *problem) {
  for (int i = 0; i < FOLDERS; i++)
    LOD_TRY(sweep_folder(objects, i, problem));
  *missing = 0;
  size_t position = 0;
  for (const struct lod_object_entry *entry; (entry = lod_table_next(&objects->entries, &position)) != NULL;)
    *missing += !file_is_whole(objects, entry);
  return LOD_OK;
}

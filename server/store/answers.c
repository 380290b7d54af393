#include "server/store/answers.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>
#include <zlib.h>

#include "server/store/files.h"
#include "server/store/store.h"
#include "server/store/table.h"

enum { FOOTER = 24, NAME = LOD_ANSWER_KEY + 1 + LOD_MODEL_ID_MAX + 1, FACTS_MAX = 4096, PENDING_MAX = 32, WRITER_NICE = 10 };
static const uint64_t kPendingBytes = UINT64_C(128) << 20;
static const char kMagic[8] = {'L', 'O', 'D', 'A', 'N', 'S', 'W', '1'};
static const char kNew[] = ".new";

struct entry {
  char key[LOD_ANSWER_KEY + 1], id[LOD_MODEL_ID_MAX + 1];
  uint64_t bytes; /* of the file */
  struct timespec used;
  struct entry *older, *newer;
};

struct pending {
  char key[LOD_ANSWER_KEY + 1], id[LOD_MODEL_ID_MAX + 1];
  const uint8_t *bytes;
  size_t size;
  char *facts;
  void *held;
  void (*release)(void *held);
  struct pending *next;
};

struct lod_answers {
  int folder_fd;
  pthread_mutex_t mutex; /* guards all below; held over no write and no read of a file */
  pthread_cond_t wake;
  struct lod_table entries;
  struct entry *oldest, *newest;
  uint64_t limit;
  struct pending *first, **last;
  uint64_t pending_count, pending_bytes;
  struct pending *writing; /* what the thread has taken; its id is emptied when its model goes meanwhile */
  struct lod_answers_counts counts;
  pthread_t writer;
  bool writer_runs, closing;
};

/* ---- the index; the mutex is held ---- */

struct name {
  char text[NAME];
};
static struct name name_of(const char *key, const char *id) {
  struct name name;
  snprintf(name.text, sizeof name.text, "%s.%s", key, id);
  return name;
}

static void unlink_list(struct lod_answers *a, struct entry *e) {
  *(e->older != NULL ? &e->older->newer : &a->oldest) = e->newer;
  *(e->newer != NULL ? &e->newer->older : &a->newest) = e->older;
}

static void link_newest(struct lod_answers *a, struct entry *e) {
  e->older = a->newest;
  e->newer = NULL;
  *(e->older != NULL ? &e->older->newer : &a->oldest) = e;
  a->newest = e;
}

/* The entry and its file. Readers that have it mapped keep it. */
static void drop(struct lod_answers *a, struct entry *e) {
  unlink_list(a, e);
  lod_table_remove(&a->entries, e->key);
  a->counts.files--;
  a->counts.bytes -= e->bytes;
  unlinkat(a->folder_fd, name_of(e->key, e->id).text, 0);
  free(e);
}

static void evict(struct lod_answers *a) {
  while (a->oldest != NULL && a->counts.bytes > a->limit) {
    drop(a, a->oldest);
    a->counts.evicted++;
  }
}

static bool add(struct lod_answers *a, const char *key, const char *id, uint64_t bytes) {
  struct entry *e = lod_table_reserve(&a->entries) ? calloc(1, sizeof *e) : NULL;
  if (e == NULL)
    return false;
  snprintf(e->key, sizeof e->key, "%s", key);
  snprintf(e->id, sizeof e->id, "%s", id);
  e->bytes = bytes;
  lod_table_insert(&a->entries, e->key, e);
  link_newest(a, e);
  a->counts.files++;
  a->counts.bytes += bytes;
  return true;
}

/* ---- reading ---- */

static uint64_t number(const uint8_t *at, int size) {
  uint64_t value = 0;
  for (int i = size; i-- > 0;)
    value = value << 8 | at[i];
  return value;
}

static uint32_t checksum(uint32_t crc, const void *bytes, size_t size) {
  return (uint32_t)crc32_z(crc, bytes, size);
}

/* Whether a mapped file is whole. */
static bool take_apart(struct lod_answer *answer) {
  const uint8_t *end = answer->bytes + answer->mapped;
  uint64_t size = number(end - FOOTER, 8), facts = number(end - FOOTER + 8, 4);
  if (memcmp(end - sizeof kMagic, kMagic, sizeof kMagic) != 0 || facts > FACTS_MAX || size > answer->mapped ||
      size + facts + FOOTER != answer->mapped ||
      number(end - FOOTER + 12, 4) != checksum(checksum(0, NULL, 0), answer->bytes, answer->mapped - 12))
    return false;
  answer->size = (size_t)size;
  answer->facts = strndup((const char *)answer->bytes + size, (size_t)facts);
  return answer->facts != NULL;
}

void lod_answer_release(struct lod_answer *answer) {
  if (answer == NULL)
    return;
  if (answer->bytes != NULL)
    munmap((void *)(uintptr_t)answer->bytes, answer->mapped);
  if (answer->file >= 0)
    close(answer->file);
  free(answer->facts);
  free(answer);
}

static struct lod_answer *map(int folder_fd, const char *name, bool use) {
  struct lod_answer *answer = calloc(1, sizeof *answer);
  struct stat facts;
  if (answer == NULL)
    return NULL;
  answer->file = openat(folder_fd, name, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
  if (answer->file >= 0 && fstat(answer->file, &facts) == 0 && facts.st_size > FOOTER) {
    void *bytes = mmap(NULL, (size_t)facts.st_size, PROT_READ, MAP_SHARED | MAP_POPULATE, answer->file, 0);
    answer->bytes = bytes == MAP_FAILED ? NULL : bytes;
    answer->mapped = (size_t)facts.st_size;
    if (use)
      futimens(answer->file, NULL); /* the order of use outlives a restart */
  }
  if (answer->bytes != NULL && take_apart(answer))
    return answer;
  lod_answer_release(answer);
  return NULL;
}

struct lod_answer *lod_answers_find(struct lod_answers *a, const char *key) {
  struct name name;
  pthread_mutex_lock(&a->mutex);
  struct entry *e = lod_table_find(&a->entries, key);
  if (e != NULL) {
    unlink_list(a, e);
    link_newest(a, e);
    name = name_of(e->key, e->id);
  }
  pthread_mutex_unlock(&a->mutex);
  if (e == NULL)
    return NULL;
  struct lod_answer *answer = map(a->folder_fd, name.text, true);
  pthread_mutex_lock(&a->mutex);
  if (answer != NULL) {
    a->counts.hits++;
  } else if ((e = lod_table_find(&a->entries, key)) != NULL) {
    drop(a, e);
    a->counts.lost++;
  }
  pthread_mutex_unlock(&a->mutex);
  return answer;
}

/* ---- writing ---- */

static void finish_pending(struct pending *p) {
  if (p == NULL)
    return;
  p->release(p->held);
  free(p->facts);
  free(p);
}

static bool write_all(int fd, const void *bytes, size_t size) {
  for (size_t at = 0; at < size;) {
    ssize_t written = write(fd, (const char *)bytes + at, size - at);
    if (written < 0 && errno == EINTR)
      continue;
    if (written <= 0)
      return false;
    at += (size_t)written;
  }
  return true;
}

/* Under a name of its own, whole. */
static bool write_file(int folder_fd, const struct pending *p, uint64_t *bytes) {
  size_t facts = strlen(p->facts);
  uint8_t footer[FOOTER];
  for (int i = 0; i < 8; i++)
    footer[i] = (uint8_t)((uint64_t)p->size >> 8 * i);
  for (int i = 0; i < 4; i++)
    footer[8 + i] = (uint8_t)(facts >> 8 * i);
  uint32_t crc = checksum(checksum(checksum(checksum(0, NULL, 0), p->bytes, p->size), p->facts, facts), footer, 12);
  for (int i = 0; i < 4; i++)
    footer[12 + i] = (uint8_t)(crc >> 8 * i);
  memcpy(footer + 16, kMagic, sizeof kMagic);
  int fd = openat(folder_fd, kNew, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (fd < 0)
    return false;
  bool written = write_all(fd, p->bytes, p->size) && write_all(fd, p->facts, facts) && write_all(fd, footer, sizeof footer);
  written &= close(fd) == 0;
  *bytes = p->size + facts + FOOTER;
  if (!written)
    unlinkat(folder_fd, kNew, 0);
  return written;
}

static void *write_behind(void *argument) {
  struct lod_answers *a = argument;
  setpriority(PRIO_PROCESS, (id_t)syscall(SYS_gettid), WRITER_NICE); /* answers that somebody waits for come first */
  pthread_mutex_lock(&a->mutex);
  while (true) {
    struct pending *p = a->first;
    if (p == NULL && a->closing)
      break;
    if (p == NULL) {
      pthread_cond_wait(&a->wake, &a->mutex);
      continue;
    }
    a->first = p->next;
    if (a->first == NULL)
      a->last = &a->first;
    a->pending_count--;
    a->pending_bytes -= p->size;
    a->writing = p;
    bool wanted = p->size <= a->limit / 4 && lod_table_find(&a->entries, p->key) == NULL;
    pthread_mutex_unlock(&a->mutex);
    uint64_t bytes = 0;
    bool written = wanted && write_file(a->folder_fd, p, &bytes);
    pthread_mutex_lock(&a->mutex);
    a->writing = NULL;
    if (written && p->id[0] != 0 && renameat(a->folder_fd, kNew, a->folder_fd, name_of(p->key, p->id).text) == 0 &&
        add(a, p->key, p->id, bytes)) {
      a->counts.written++;
      evict(a);
    } else {
      a->counts.lost += wanted;
      unlinkat(a->folder_fd, kNew, 0);
    }
    pthread_mutex_unlock(&a->mutex);
    finish_pending(p);
    pthread_mutex_lock(&a->mutex);
  }
  pthread_mutex_unlock(&a->mutex);
  return NULL;
}

void lod_answers_keep(struct lod_answers *a, const char *id, const char *key, const uint8_t *bytes, size_t size, const char *facts,
                      void *held, void (*release)(void *held)) {
  struct pending *p = strlen(facts) <= FACTS_MAX ? calloc(1, sizeof *p) : NULL, *refused = NULL;
  if (p == NULL || (p->facts = strdup(facts)) == NULL) {
    free(p);
    release(held);
    return;
  }
  snprintf(p->key, sizeof p->key, "%s", key);
  snprintf(p->id, sizeof p->id, "%s", id);
  p->bytes = bytes;
  p->size = size;
  p->held = held;
  p->release = release;
  pthread_mutex_lock(&a->mutex);
  if (!a->writer_runs || size > a->limit / 4 || a->pending_count >= PENDING_MAX || a->pending_bytes + size > kPendingBytes) {
    a->counts.lost += a->limit != 0;
    refused = p;
  } else {
    *a->last = p;
    a->last = &p->next;
    a->pending_count++;
    a->pending_bytes += size;
    pthread_cond_signal(&a->wake);
  }
  pthread_mutex_unlock(&a->mutex);
  finish_pending(refused);
}

void lod_answers_forget(struct lod_answers *a, const char *id) {
  struct pending *gone = NULL;
  pthread_mutex_lock(&a->mutex);
  for (struct entry *e = a->oldest, *newer; e != NULL; e = newer) {
    newer = e->newer;
    if (strcmp(e->id, id) == 0)
      drop(a, e);
  }
  for (struct pending **at = &a->first; *at != NULL;) {
    struct pending *p = *at;
    if (strcmp(p->id, id) != 0) {
      at = &p->next;
      continue;
    }
    *at = p->next;
    a->pending_count--;
    a->pending_bytes -= p->size;
    p->next = gone;
    gone = p;
  }
  a->last = &a->first;
  while (*a->last != NULL)
    a->last = &(*a->last)->next;
  if (a->writing != NULL && strcmp(a->writing->id, id) == 0)
    a->writing->id[0] = 0;
  pthread_mutex_unlock(&a->mutex);
  for (struct pending *next; gone != NULL; gone = next) {
    next = gone->next;
    finish_pending(gone);
  }
}

/* ---- birth and end ---- */

void lod_answers_set_limit(struct lod_answers *a, uint64_t bytes) {
  pthread_mutex_lock(&a->mutex);
  a->limit = bytes;
  evict(a);
  pthread_mutex_unlock(&a->mutex);
}

void lod_answers_sweep(struct lod_answers *a, bool (*there)(void *context, const char *id), void *context) {
  pthread_mutex_lock(&a->mutex);
  for (struct entry *e = a->oldest, *newer; e != NULL; e = newer) {
    newer = e->newer;
    if (!there(context, e->id))
      drop(a, e);
  }
  pthread_mutex_unlock(&a->mutex);
}

static int compare_used(const void *x, const void *y) {
  const struct timespec *a = &(*(struct entry *const *)x)->used, *b = &(*(struct entry *const *)y)->used;
  return a->tv_sec != b->tv_sec ? (a->tv_sec > b->tv_sec) - (a->tv_sec < b->tv_sec) : (a->tv_nsec > b->tv_nsec) - (a->tv_nsec < b->tv_nsec);
}

static bool is_name(const char *name) {
  return strspn(name, "0123456789abcdef") == LOD_ANSWER_KEY && name[LOD_ANSWER_KEY] == '.' && lod_model_id_valid(name + LOD_ANSWER_KEY + 1);
}

const char *lod_answer_judge(int folder_fd, const char *name, const char **id) {
  struct stat facts;
  *id = is_name(name) ? name + LOD_ANSWER_KEY + 1 : NULL;
  if (*id == NULL || fstatat(folder_fd, name, &facts, AT_SYMLINK_NOFOLLOW) != 0 || !S_ISREG(facts.st_mode))
    return "no answer";
  struct lod_answer *answer = map(folder_fd, name, false);
  const bool whole = answer != NULL;
  lod_answer_release(answer);
  return whole ? "" : "damaged or cut short";
}

/* What the folder has, the least recently used first. What is no answer goes. */
static bool read_folder(struct lod_answers *a) {
  struct lod_name_list list = lod_list_folder(a->folder_fd);
  struct entry **sorted = calloc(list.count + 1, sizeof *sorted);
  size_t count = 0;
  for (size_t i = 0; sorted != NULL && i < list.count; i++) {
    struct stat facts;
    char key[LOD_ANSWER_KEY + 1];
    const char *name = list.names[i];
    if (!is_name(name) || fstatat(a->folder_fd, name, &facts, AT_SYMLINK_NOFOLLOW) != 0 || !S_ISREG(facts.st_mode)) {
      lod_remove_tree(a->folder_fd, name);
      continue;
    }
    snprintf(key, sizeof key, "%.*s", LOD_ANSWER_KEY, name);
    if (lod_table_find(&a->entries, key) != NULL || !add(a, key, name + LOD_ANSWER_KEY + 1, (uint64_t)facts.st_size)) {
      unlinkat(a->folder_fd, name, 0);
      continue;
    }
    a->newest->used = facts.st_mtim;
    sorted[count++] = a->newest;
  }
  lod_name_list_finish(&list);
  if (sorted == NULL)
    return false;
  qsort(sorted, count, sizeof *sorted, compare_used);
  a->oldest = a->newest = NULL;
  for (size_t i = 0; i < count; i++)
    link_newest(a, sorted[i]);
  free(sorted);
  return true;
}

enum lod_status lod_answers_open(int directory_fd, struct lod_answers **result, struct lod_problem *problem) {
  *result = NULL;
  struct lod_answers *a = calloc(1, sizeof *a);
  if (a == NULL)
    return lod_fail_memory(problem);
  a->last = &a->first;
  a->folder_fd = -1;
  pthread_mutex_init(&a->mutex, NULL);
  pthread_cond_init(&a->wake, NULL);
  enum lod_status status = LOD_OK;
  if (mkdirat(directory_fd, "refined", 0700) != 0 && errno != EEXIST)
    status = lod_fail_errno(problem, "The store's folder of refinements cannot be made");
  else if ((a->folder_fd = openat(directory_fd, "refined", O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW)) < 0)
    status = lod_fail_errno(problem, "The store's folder of refinements cannot be opened");
  else if (!read_folder(a))
    status = lod_fail_memory(problem);
  if (status == LOD_OK) {
    a->writer_runs = pthread_create(&a->writer, NULL, write_behind, a) == 0;
    status = a->writer_runs ? LOD_OK : lod_fail_memory(problem);
  }
  if (status != LOD_OK) {
    lod_answers_close(a);
    return status;
  }
  *result = a;
  return LOD_OK;
}

void lod_answers_close(struct lod_answers *a) {
  if (a == NULL)
    return;
  if (a->writer_runs) {
    pthread_mutex_lock(&a->mutex);
    a->closing = true;
    pthread_cond_signal(&a->wake);
    pthread_mutex_unlock(&a->mutex);
    pthread_join(a->writer, NULL);
  }
  for (struct entry *e = a->oldest, *newer; e != NULL; e = newer) {
    newer = e->newer;
    free(e);
  }
  lod_table_finish(&a->entries);
  if (a->folder_fd >= 0)
    close(a->folder_fd);
  pthread_cond_destroy(&a->wake);
  pthread_mutex_destroy(&a->mutex);
  free(a);
}

struct lod_answers_counts lod_answers_counts(struct lod_answers *a) {
  pthread_mutex_lock(&a->mutex);
  struct lod_answers_counts counts = a->counts;
  pthread_mutex_unlock(&a->mutex);
  return counts;
}

#include "server/models_dir.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <nettle/sha2.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/eventfd.h>
#include <sys/inotify.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/log.h"

struct lod_models_dir {
  int directory_fd, inotify_fd, wake_fd;
  struct lod_store *store;
  struct lod_jobs *jobs;
  atomic_bool ending;
  bool retry; /* a file was refused because the queue was full: look at all again soon */
  pthread_t thread;
};

/* What lies beside models without being one. */
static const char *const kCompanions[] = {"bin", "png", "jpg",  "jpeg",    "webp", "ktx2", "tga",        "bmp", "mtl",
                                          "txt", "md",  "json", "license", "part", "tmp",  "crdownload", "swp"};

bool lod_models_dir_id(const char *name, char id[LOD_MODEL_ID_MAX + 1]) {
  const char *dot = strrchr(name, '.');
  if (*name == '.' || !*name || name[strlen(name) - 1] == '~')
    return false;
  for (size_t i = 0; dot && i < sizeof kCompanions / sizeof *kCompanions; i++)
    if (strcasecmp(dot + 1, kCompanions[i]) == 0)
      return false;
  size_t size = dot ? (size_t)(dot - name) : strlen(name), used = 0;
  for (size_t i = 0; i < size && used < LOD_MODEL_ID_MAX; i++) {
    char c = name[i];
    bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '_' || c == '-';
    char safe = plain ? c : '-';
    if (used || (safe != '-' && safe != '.')) /* an id begins with neither */
      id[used++] = safe;
  }
  id[used] = 0;
  return lod_model_id_valid(id);
}

/* Copies the file into an upload and hashes it on the way, so that what is hashed is what is baked. *upload is -1 on failure. */
static enum lod_status copy_file(struct lod_models_dir *watch, int file, int *upload, char sha256[LOD_SHA256_HEX + 1],
                                 struct lod_problem *problem) {
  enum { PIECE = 1 << 20 };
  *upload = -1;
  uint8_t *piece = malloc(PIECE), digest[SHA256_DIGEST_SIZE];
  struct sha256_ctx hash;
  sha256_init(&hash);
  enum lod_status status = piece ? lod_jobs_upload_create(watch->jobs, upload, problem) : lod_fail_memory(problem);
  while (status == LOD_OK && !atomic_load(&watch->ending)) {
    ssize_t size = read(file, piece, PIECE);
    if (size < 0 && errno == EINTR)
      continue;
    if (size == 0)
      break;
    for (ssize_t done = 0; size > 0 && done < size;) {
      ssize_t written = write(*upload, piece + done, (size_t)(size - done));
      if (written < 0 && errno != EINTR) {
        size = -1;
        break;
      }
      done += written > 0 ? written : 0;
    }
    if (size < 0)
      status = lod_fail(problem, LOD_IO, "io", "The file could not be copied into the store: %s.", strerror(errno));
    else
      sha256_update(&hash, (size_t)size, piece);
  }
  free(piece);
  if (status == LOD_OK && atomic_load(&watch->ending))
    status = LOD_CANCELLED;
  if (status != LOD_OK) {
    if (*upload >= 0)
      close(*upload);
    *upload = -1;
    return status;
  }
  sha256_digest(&hash, sizeof digest, digest);
  for (size_t i = 0; i < sizeof digest; i++)
    snprintf(sha256 + 2 * i, 3, "%02x", digest[i]);
  return LOD_OK;
}

/* Whether the store's revision of `id` was made of these bytes. */
static bool is_stored(struct lod_models_dir *watch, const char *id, const char *sha256) {
  struct lod_stored_model *model = lod_store_model_open(watch->store, id);
  json_t *manifest = model ? json_loadb(model->manifest, model->manifest_size, 0, NULL) : NULL;
  const char *source = json_string_value(json_object_get(json_object_get(manifest, "source"), "sha256"));
  bool same = source && strcmp(source, sha256) == 0;
  json_decref(manifest);
  lod_store_model_release(model);
  return same;
}

static void submit_file(struct lod_models_dir *watch, const char *name, const char *id) {
  struct lod_problem problem = {0};
  struct stat status;
  char sha256[LOD_SHA256_HEX + 1];
  int upload, file = openat(watch->directory_fd, name, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (file < 0 || fstat(file, &status) != 0 || !S_ISREG(status.st_mode) || status.st_size == 0) {
    if (file >= 0)
      close(file);
    return; /* gone again, a folder, or not written yet: its close will be an event */
  }
  enum lod_status result = copy_file(watch, file, &upload, sha256, &problem);
  close(file);
  uint64_t job = 0;
  if (result == LOD_OK && is_stored(watch, id, sha256)) {
    close(upload);
    lod_log(LOD_LOG_DEBUG, "--models: '%s' is stored already", name);
    return;
  }
  if (result == LOD_OK)
    result = lod_jobs_submit(watch->jobs, id, name, NULL, upload, &job, &problem);
  if (result == LOD_LIMIT && strcmp(problem.type, "queue-full") == 0)
    watch->retry = true;
  else if (result == LOD_OK)
    lod_log(LOD_LOG_INFO, "--models: '%s' is baked as '%s', job %llu", name, id, (unsigned long long)job);
  else if (result != LOD_CANCELLED)
    lod_log(LOD_LOG_WARN, "--models: '%s': %s", name, problem.detail);
}

static int by_name(const void *a, const void *b) {
  return strcmp(*(char *const *)a, *(char *const *)b);
}

/* Names of the folder that are models, sorted; *count of them. */
static char **list_names(struct lod_models_dir *watch, size_t *count) {
  char **names = NULL, id[LOD_MODEL_ID_MAX + 1];
  size_t capacity = 0;
  *count = 0;
  int fd = openat(watch->directory_fd, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  DIR *directory = fd >= 0 ? fdopendir(fd) : NULL;
  for (struct dirent *entry; directory && (entry = readdir(directory)) != NULL;) {
    if (!lod_models_dir_id(entry->d_name, id))
      continue;
    if (*count == capacity) {
      capacity = capacity ? 2 * capacity : 64;
      char **more = realloc(names, capacity * sizeof *names);
      if (!more)
        break;
      names = more;
    }
    if ((names[*count] = strdup(entry->d_name)) != NULL)
      ++*count;
  }
  if (directory)
    closedir(directory);
  if (names)
    qsort(names, *count, sizeof *names, by_name);
  return names;
}

/* Submits `only`, or every file when it is NULL. Of files with one id the first by name counts, so that two never take turns. */
static void scan(struct lod_models_dir *watch, const char *only) {
  size_t count;
  char **names = list_names(watch, &count), id[LOD_MODEL_ID_MAX + 1], other[LOD_MODEL_ID_MAX + 1];
  for (size_t i = 0; i < count; i++) {
    if ((only && strcmp(names[i], only) != 0) || !lod_models_dir_id(names[i], id) || atomic_load(&watch->ending))
      continue;
    size_t first = 0;
    while (first < i && !(lod_models_dir_id(names[first], other) && strcmp(id, other) == 0))
      first++;
    if (first < i)
      lod_log(LOD_LOG_WARN, "--models: '%s' is left out: '%s' has the same base name", names[i], names[first]);
    else
      submit_file(watch, names[i], id);
  }
  for (size_t i = 0; i < count; i++)
    free(names[i]);
  free(names);
}

static void *run(void *argument) {
  enum { RETRY_MS = 2000 };
  struct lod_models_dir *watch = argument;
  _Alignas(struct inotify_event) char buffer[64 << 10];
  scan(watch, NULL);
  while (!atomic_load(&watch->ending)) {
    struct pollfd polled[2] = {{watch->inotify_fd, POLLIN, 0}, {watch->wake_fd, POLLIN, 0}};
    int ready = poll(polled, 2, watch->retry ? RETRY_MS : -1);
    if (ready == 0) {
      watch->retry = false;
      scan(watch, NULL);
    }
    ssize_t size = ready > 0 && polled[0].revents ? read(watch->inotify_fd, buffer, sizeof buffer) : 0;
    for (ssize_t at = 0; at < size;) {
      const struct inotify_event *event = (const struct inotify_event *)(const void *)(buffer + at);
      at += (ssize_t)(sizeof *event + event->len);
      if (event->mask & IN_Q_OVERFLOW)
        scan(watch, NULL);
      else if (event->len)
        scan(watch, event->name);
    }
  }
  return NULL;
}

enum lod_status lod_models_dir_create(const char *directory, struct lod_store *store, struct lod_jobs *jobs, struct lod_models_dir **result,
                                      struct lod_problem *problem) {
  struct lod_models_dir *watch = calloc(1, sizeof *watch);
  *result = NULL;
  if (!watch)
    return lod_fail_memory(problem);
  watch->store = store;
  watch->jobs = jobs;
  watch->directory_fd = open(directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  watch->inotify_fd = inotify_init1(IN_CLOEXEC | IN_NONBLOCK);
  watch->wake_fd = eventfd(0, EFD_CLOEXEC);
  bool good = watch->directory_fd >= 0 && watch->inotify_fd >= 0 && watch->wake_fd >= 0 &&
              inotify_add_watch(watch->inotify_fd, directory, IN_CLOSE_WRITE | IN_MOVED_TO | IN_ONLYDIR) >= 0;
  /* Watching begins before the first scan, so that no file falls between. */
  if (good && pthread_create(&watch->thread, NULL, run, watch) == 0) {
    *result = watch;
    return LOD_OK;
  }
  enum lod_status status =
      lod_fail(problem, LOD_BAD_INPUT, "bad-setting", "--models: '%s' cannot be watched: %s.", directory, strerror(errno));
  int fds[] = {watch->directory_fd, watch->inotify_fd, watch->wake_fd};
  for (int i = 0; i < 3; i++)
    if (fds[i] >= 0)
      close(fds[i]);
  free(watch);
  return status;
}

void lod_models_dir_destroy(struct lod_models_dir *watch) {
  if (!watch)
    return;
  uint64_t one = 1;
  atomic_store(&watch->ending, true);
  ssize_t ignored = write(watch->wake_fd, &one, sizeof one);
  (void)ignored;
  pthread_join(watch->thread, NULL);
  close(watch->directory_fd);
  close(watch->inotify_fd);
  close(watch->wake_fd);
  free(watch);
}

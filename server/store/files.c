#include "server/store/files.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum lod_status lod_fail_errno(struct lod_problem *problem, const char *what) {
  int code = errno;
  switch (code) {
  case ENOMEM:
    return lod_fail_memory(problem);
  case ENOSPC:
  case EDQUOT:
    return lod_fail(problem, LOD_IO, "disk-full", "%s: %s. Nothing was changed; free some space and try again.", what, strerror(code));
  case EROFS:
  case EACCES:
  case EPERM:
    return lod_fail(problem, LOD_IO, "store-read-only", "%s: %s. The store must be a writable directory.", what, strerror(code));
  default:
    return lod_fail(problem, LOD_IO, "store-error", "%s: %s.", what, strerror(code));
  }
}

static bool is_dots(const char *name) {
  return strcmp(name, ".") == 0 || strcmp(name, "..") == 0;
}

static DIR *open_folder(int folder_fd, const char *name) {
  int fd = openat(folder_fd, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  if (fd < 0 && errno == EACCES && fchmodat(folder_fd, name, 0700, 0) == 0)
    fd = openat(folder_fd, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  DIR *folder = fd < 0 ? NULL : fdopendir(fd);
  if (folder == NULL && fd >= 0)
    close(fd);
  return folder;
}

static bool remove_one(int folder_fd, const char *name) {
  return unlinkat(folder_fd, name, 0) == 0 || unlinkat(folder_fd, name, AT_REMOVEDIR) == 0 || errno == ENOENT;
}

/* Empties a folder beneath `top_fd`: what is not empty itself moves up to the top under a number, to be emptied in its turn. */
static void flatten(int top_fd, const char *name, uint64_t *counter) {
  DIR *folder = open_folder(top_fd, name);
  if (folder == NULL)
    return;
  for (const struct dirent *file; (file = readdir(folder)) != NULL;) {
    if (is_dots(file->d_name) || remove_one(dirfd(folder), file->d_name))
      continue;
    char place[32];
    int tries = 0;
    do
      snprintf(place, sizeof place, "~%llu", (unsigned long long)(*counter)++);
    while (renameat(dirfd(folder), file->d_name, top_fd, place) != 0 && ++tries < 16);
  }
  closedir(folder);
}

void lod_empty_folder(int folder_fd, const char *name) {
  uint64_t counter = 0;
  /* Each pass removes at least one folder, unless the disk refuses. */
  for (bool again = true, progress = true; again && progress;) {
    DIR *folder = open_folder(folder_fd, name);
    if (folder == NULL)
      return;
    again = progress = false;
    for (const struct dirent *file; (file = readdir(folder)) != NULL;) {
      if (is_dots(file->d_name))
        continue;
      if (!remove_one(dirfd(folder), file->d_name)) {
        again = true;
        flatten(dirfd(folder), file->d_name, &counter);
        progress |= unlinkat(dirfd(folder), file->d_name, AT_REMOVEDIR) == 0;
      } else {
        progress = true;
      }
    }
    closedir(folder);
  }
}

void lod_remove_tree(int folder_fd, const char *name) {
  if (unlinkat(folder_fd, name, 0) == 0)
    return;
  lod_empty_folder(folder_fd, name);
  unlinkat(folder_fd, name, AT_REMOVEDIR);
}

struct lod_name_list lod_list_folder(int folder_fd) {
  struct lod_name_list list = {0};
  DIR *folder = open_folder(folder_fd, ".");
  if (folder == NULL)
    return list;
  for (const struct dirent *file; (file = readdir(folder)) != NULL;) {
    char **names = is_dots(file->d_name) ? NULL : reallocarray(list.names, list.count + 1, sizeof *names);
    if (names == NULL)
      continue;
    list.names = names;
    names[list.count] = strdup(file->d_name);
    list.count += names[list.count] != NULL;
  }
  closedir(folder);
  return list;
}

void lod_name_list_finish(struct lod_name_list *list) {
  for (size_t i = 0; i < list->count; i++)
    free(list->names[i]);
  free(list->names);
  *list = (struct lod_name_list){0};
}

static int hex_digit(char digit) {
  return digit <= '9' ? digit - '0' : digit - 'a' + 10;
}
int lod_hex_byte(const char *hex) {
  return hex_digit(hex[0]) * 16 + hex_digit(hex[1]);
}

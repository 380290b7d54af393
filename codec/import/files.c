/* Files beneath an open directory. The kernel's openat2 does the whole check at once; where it is missing the path is walked segment by
 * segment, every one opened with O_NOFOLLOW from the one before, which gives the same answer for regular trees. */
#include <errno.h>
#include <fcntl.h>
#include <linux/openat2.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "codec/import/import.h"

static int open_walking(int directory, const char *path) {
  int current = directory;
  for (;;) {
    path += strspn(path, "/");
    size_t n = strcspn(path, "/");
    char segment[256];
    if (n == 0 || n >= sizeof segment || (n == 2 && memcmp(path, "..", 2) == 0)) {
      errno = EINVAL;
      break;
    }
    memcpy(segment, path, n);
    segment[n] = 0;
    path += n;
    bool last = path[strspn(path, "/")] == 0;
    int next = openat(current, segment, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK | (last ? 0 : O_DIRECTORY));
    if (current != directory)
      close(current);
    if (next < 0 || last)
      return next;
    current = next;
  }
  if (current != directory)
    close(current);
  return -1;
}

static int open_beneath(int directory, const char *path) {
  struct open_how how = {
      .flags = O_RDONLY | O_CLOEXEC | O_NONBLOCK,
      .resolve = RESOLVE_BENEATH | RESOLVE_NO_SYMLINKS | RESOLVE_NO_MAGICLINKS,
  };
  long fd = syscall(SYS_openat2, directory, path, &how, sizeof how);
  /* A seccomp filter answers EPERM or ENOSYS for calls it does not know. */
  if (fd < 0 && (errno == ENOSYS || errno == EPERM || errno == EINVAL))
    return open_walking(directory, path);
  return (int)fd;
}

static enum lod_status read_open_file(int fd, const char *uri, struct lod_arena *arena, const uint8_t **bytes, size_t *size,
                                      struct lod_problem *problem) {
  struct stat status;
  if (fstat(fd, &status) != 0 || !S_ISREG(status.st_mode))
    return lod_fail(problem, LOD_BAD_INPUT, "missing-file", "'%.200s' is no regular file", uri);
  size_t total = (size_t)status.st_size;
  uint8_t *buffer = lod_arena_alloc(arena, total, 1);
  if (!buffer)
    return lod_fail_memory(problem);
  size_t have = 0;
  while (have < total) {
    ssize_t n = read(fd, buffer + have, total - have);
    if (n < 0 && errno == EINTR)
      continue;
    if (n < 0)
      return lod_fail(problem, LOD_IO, "read-failed", "'%.200s' cannot be read: %s", uri, strerror(errno));
    if (n == 0)
      break;
    have += (size_t)n;
  }
  *bytes = buffer;
  *size = have;
  return LOD_OK;
}

static enum lod_status read_beneath(void *context, const char *uri, struct lod_arena *arena, const uint8_t **bytes, size_t *size,
                                    struct lod_problem *problem) {
  const int *directory = context;
  int fd = open_beneath(*directory, uri);
  if (fd < 0)
    return lod_fail(problem, LOD_BAD_INPUT, "missing-file", "'%.200s', which the model refers to, cannot be opened: %s", uri,
                    strerror(errno));
  enum lod_status result = read_open_file(fd, uri, arena, bytes, size, problem);
  close(fd);
  return result;
}

struct lod_import_files lod_import_files_beneath(int *directory_fd) {
  return (struct lod_import_files){.read = read_beneath, .context = directory_fd};
}

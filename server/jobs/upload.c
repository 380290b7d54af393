#include "server/jobs/upload.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <unistd.h>

#include "server/store/files.h"

enum lod_status lod_upload_create(int folder_fd, int *fd, struct lod_problem *problem) {
  *fd = openat(folder_fd, ".", O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (*fd >= 0)
    return LOD_OK;
  if (errno != EOPNOTSUPP && errno != EISDIR && errno != EINVAL)
    return lod_fail_errno(problem, "An upload cannot be stored");
  /* A file system without unnamed files: a named one, swept at the next start should we die before the unlink. */
  static _Atomic uint64_t counter;
  char name[48];
  snprintf(name, sizeof name, ".new-%" PRIu64, counter++);
  *fd = openat(folder_fd, name, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (*fd < 0)
    return lod_fail_errno(problem, "An upload cannot be stored");
  unlinkat(folder_fd, name, 0);
  return LOD_OK;
}

static enum lod_status copy_upload(int folder_fd, int fd, const char *name, struct lod_problem *problem) {
  int to = openat(folder_fd, name, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0600);
  if (to < 0)
    return lod_fail_errno(problem, "An upload cannot be stored");
  enum lod_status status = LOD_OK;
  off_t from = 0;
  for (;;) {
    ssize_t moved = copy_file_range(fd, &from, to, NULL, 1 << 30, 0);
    if (moved == 0)
      break;
    if (moved < 0 && errno != EINTR) {
      status = lod_fail_errno(problem, "An upload cannot be stored");
      break;
    }
  }
  if (status == LOD_OK && fsync(to) != 0)
    status = lod_fail_errno(problem, "An upload cannot be synced");
  close(to);
  return status;
}

enum lod_status lod_upload_name(int folder_fd, int fd, const char *name, struct lod_problem *problem) {
  char path[48];
  if (fsync(fd) != 0)
    return lod_fail_errno(problem, "An upload cannot be synced");
  snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
  if (linkat(AT_FDCWD, path, folder_fd, name, AT_SYMLINK_FOLLOW) != 0)
    LOD_TRY(copy_upload(folder_fd, fd, name, problem)); /* no /proc, or a file that was unlinked */
  return fsync(folder_fd) == 0 ? LOD_OK : lod_fail_errno(problem, "The folder of uploads cannot be synced");
}

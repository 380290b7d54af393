#include "server/worker/output.h"

#include <errno.h>
#include <fcntl.h>
#include <nettle/sha2.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

void lod_hash_bytes(const void *bytes, size_t size, char hex[LOD_HASH_HEX + 1]) {
  struct sha256_ctx context;
  uint8_t digest[SHA256_DIGEST_SIZE];
  sha256_init(&context);
  sha256_update(&context, size, bytes);
  sha256_digest(&context, sizeof digest, digest);
  for (size_t i = 0; i < sizeof digest; i++)
    snprintf(hex + 2 * i, 3, "%02x", digest[i]);
}

static bool write_all(int fd, const uint8_t *bytes, size_t size) {
  while (size > 0) {
    ssize_t written = write(fd, bytes, size);
    if (written < 0) {
      if (errno == EINTR)
        continue;
      return false;
    }
    bytes += written;
    size -= (size_t)written;
  }
  return true;
}

static enum lod_status write_file(int directory_fd, const char *name, const void *bytes, size_t size, struct lod_problem *problem) {
  static const char kTemporary[] = ".writing";
  int fd = openat(directory_fd, kTemporary, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (fd < 0)
    return lod_fail(problem, LOD_IO, "write-failed", "Cannot write to the output directory: %s.", strerror(errno));
  bool ok = write_all(fd, bytes, size) && fsync(fd) == 0;
  int error = errno;
  close(fd);
  if (ok && renameat(directory_fd, kTemporary, directory_fd, name) != 0) {
    ok = false;
    error = errno;
  }
  if (ok && fsync(directory_fd) != 0) {
    ok = false;
    error = errno;
  }
  if (ok)
    return LOD_OK;
  unlinkat(directory_fd, kTemporary, 0);
  return lod_fail(problem, LOD_IO, error == ENOSPC || error == EDQUOT ? "disk-full" : "write-failed", "Cannot write %s (%zu bytes): %s.",
                  name, size, strerror(error));
}

enum lod_status lod_output_file(int directory_fd, const char *name, const void *bytes, size_t size, struct lod_problem *problem) {
  return write_file(directory_fd, name, bytes, size, problem);
}

enum lod_status lod_output_object(int directory_fd, const void *bytes, size_t size, char hex[LOD_HASH_HEX + 1],
                                  struct lod_problem *problem) {
  lod_hash_bytes(bytes, size, hex);
  if (mkdirat(directory_fd, "objects", 0755) != 0 && errno != EEXIST)
    return lod_fail(problem, LOD_IO, "write-failed", "Cannot make objects/ in the output directory: %s.", strerror(errno));
  int objects = openat(directory_fd, "objects", O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  if (objects < 0)
    return lod_fail(problem, LOD_IO, "write-failed", "Cannot open objects/ in the output directory: %s.", strerror(errno));
  struct stat already;
  enum lod_status status = LOD_OK;
  if (fstatat(objects, hex, &already, AT_SYMLINK_NOFOLLOW) != 0 || !S_ISREG(already.st_mode) || (size_t)already.st_size != size)
    status = write_file(objects, hex, bytes, size, problem);
  close(objects);
  return status;
}

#include "server/store/intake.h"

#include <errno.h>
#include <fcntl.h>
#include <nettle/sha2.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/store/files.h"

enum { CHUNK = 1 << 18 };

static void to_hex(const uint8_t *bytes, char digest[LOD_SHA256_HEX + 1]) {
  for (int i = 0; i < SHA256_DIGEST_SIZE; i++)
    snprintf(digest + 2 * i, 3, "%02x", bytes[i]);
}

void lod_sha256_text(const void *bytes, size_t size, char digest[LOD_SHA256_HEX + 1]) {
  struct sha256_ctx context;
  uint8_t result[SHA256_DIGEST_SIZE];
  sha256_init(&context);
  sha256_update(&context, size, bytes);
  sha256_digest(&context, sizeof result, result);
  to_hex(result, digest);
}

/* A regular file with one name: a link or a second name would let somebody else change it later; a FIFO would block (O_NONBLOCK). */
static enum lod_status open_file(int folder_fd, const char *name, const char *type, int *fd, uint64_t *size, struct lod_problem *problem) {
  *fd = openat(folder_fd, name, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
  if (*fd < 0 && (errno == ENOENT || errno == ELOOP || errno == ENXIO || errno == EACCES))
    return lod_fail(problem, LOD_BAD_INPUT, type, "The worker left no regular file %.12s.", name);
  if (*fd < 0)
    return lod_fail_errno(problem, "A file that the worker wrote cannot be opened");
  struct stat facts;
  if (fstat(*fd, &facts) != 0 || !S_ISREG(facts.st_mode) || facts.st_nlink != 1) {
    close(*fd);
    return lod_fail(problem, LOD_BAD_INPUT, type, "What the worker left as %.12s is not a regular file with a single name.", name);
  }
  *size = (uint64_t)facts.st_size;
  return LOD_OK;
}

static enum lod_status read_manifest(int directory_fd, const char *id, struct lod_manifest **manifest, struct lod_problem *problem) {
  int fd;
  uint64_t size;
  LOD_TRY(open_file(directory_fd, "manifest.json", "bad-manifest", &fd, &size, problem));
  enum lod_status status = LOD_OK;
  char *text = NULL;
  if (size > LOD_MANIFEST_MAX_BYTES)
    status = lod_fail(problem, LOD_BAD_INPUT, "bad-manifest", "manifest.json is larger than %d bytes.", LOD_MANIFEST_MAX_BYTES);
  else if ((text = malloc(size + 1)) == NULL)
    status = lod_fail_memory(problem);
  size_t filled = 0;
  while (status == LOD_OK && filled < size) {
    ssize_t got = read(fd, text + filled, size - filled);
    if (got > 0)
      filled += (size_t)got;
    else if (got == 0)
      size = filled;
    else if (errno != EINTR)
      status = lod_fail_errno(problem, "manifest.json cannot be read");
  }
  close(fd);
  if (status == LOD_OK)
    status = lod_manifest_parse(text, size, id, manifest, problem);
  free(text);
  return status;
}

static enum lod_status hash_file(int fd, uint8_t *buffer, uint64_t *size, char digest[LOD_SHA256_HEX + 1], struct lod_problem *problem) {
  struct sha256_ctx context;
  uint8_t result[SHA256_DIGEST_SIZE];
  sha256_init(&context);
  *size = 0;
  for (;;) {
    ssize_t got = read(fd, buffer, CHUNK);
    if (got == 0)
      break;
    if (got < 0 && errno == EINTR)
      continue;
    if (got < 0)
      return lod_fail_errno(problem, "An object that the worker wrote cannot be read");
    sha256_update(&context, (size_t)got, buffer);
    *size += (uint64_t)got;
  }
  sha256_digest(&context, sizeof result, result);
  to_hex(result, digest);
  return LOD_OK;
}

static enum lod_status check_object(int objects_fd, struct lod_manifest_object *object, uint8_t *buffer, struct lod_problem *problem) {
  int fd;
  uint64_t size;
  char digest[LOD_SHA256_HEX + 1];
  LOD_TRY(open_file(objects_fd, object->sha256, "bad-object", &fd, &size, problem));
  enum lod_status status = LOD_OK;
  if (size == 0 || (object->bytes != 0 && size != object->bytes))
    status = lod_fail(problem, LOD_BAD_INPUT, "bad-object", "Object %.12s has %llu bytes, the manifest says %llu.", object->sha256,
                      (unsigned long long)size, (unsigned long long)object->bytes);
  if (status == LOD_OK)
    status = hash_file(fd, buffer, &object->bytes, digest, problem);
  if (status == LOD_OK && strcmp(digest, object->sha256) != 0)
    status = lod_fail(problem, LOD_BAD_INPUT, "bad-object", "Object %.12s does not have the SHA-256 that names it.", object->sha256);
  if (status == LOD_OK && (fchmod(fd, 0444) != 0 || fsync(fd) != 0))
    status = lod_fail_errno(problem, "An object cannot be synced");
  close(fd);
  return status;
}

static enum lod_status check_objects(int objects_fd, struct lod_manifest *manifest, struct lod_problem *problem) {
  uint8_t *buffer = malloc(CHUNK);
  if (buffer == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = LOD_OK;
  for (size_t i = 0; status == LOD_OK && i < manifest->object_count; i++)
    status = check_object(objects_fd, &manifest->objects[i], buffer, problem);
  free(buffer);
  return status;
}

enum lod_status lod_intake_check(int directory_fd, const char *id, struct lod_manifest **manifest, int *objects_fd,
                                 struct lod_problem *problem) {
  struct lod_manifest *result = NULL;
  LOD_TRY(read_manifest(directory_fd, id, &result, problem));
  int fd = openat(directory_fd, "objects", O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  enum lod_status status = LOD_OK;
  if (fd < 0)
    status = lod_fail(problem, LOD_BAD_INPUT, "bad-object", "The worker left no folder objects.");
  else
    status = check_objects(fd, result, problem);
  if (status != LOD_OK) {
    if (fd >= 0)
      close(fd);
    lod_manifest_destroy(result);
    return status;
  }
  *manifest = result;
  *objects_fd = fd;
  return LOD_OK;
}

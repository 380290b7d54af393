/* Files of the viewer page: whatever is beneath its folder, and nothing outside it. */
#include <errno.h>
#include <fcntl.h>
#include <linux/openat2.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "server/http/routes.h"

enum { VIEWER_FILE_MAX = 64 << 20 };

/* Media type by extension; compress: text that gzip makes smaller. */
static const struct {
  const char *extension, *type;
  bool compress;
} kTypes[] = {
    {".html", "text/html; charset=utf-8", true},
    {".js", "text/javascript; charset=utf-8", true},
    {".mjs", "text/javascript; charset=utf-8", true},
    {".css", "text/css; charset=utf-8", true},
    {".json", "application/json", true},
    {".map", "application/json", true},
    {".svg", "image/svg+xml", true},
    {".txt", "text/plain; charset=utf-8", true},
    {".wasm", "application/wasm", true},
    {".webmanifest", "application/manifest+json", true},
    {".png", "image/png", false},
    {".jpg", "image/jpeg", false},
    {".webp", "image/webp", false},
    {".ico", "image/x-icon", false},
    {".woff2", "font/woff2", false},
    {".glb", "model/gltf-binary", false},
};

static const char *type_of(const char *name, bool *compress) {
  const char *dot = strrchr(name, '.');
  for (size_t i = 0; dot && i < sizeof kTypes / sizeof *kTypes; i++)
    if (strcmp(dot, kTypes[i].extension) == 0) {
      *compress = kTypes[i].compress;
      return kTypes[i].type;
    }
  *compress = false;
  return "application/octet-stream";
}

/* The file's path beneath the folder, from decoded segments; "/" is the page. False when a segment could leave the folder, or names a
 * hidden file or a folder. */
static bool join_path(const struct lod_target *target, char *path, size_t size) {
  size_t used = 0;
  snprintf(path, size, "index.html");
  for (uint32_t i = 1; i < target->segment_count; i++) {
    const char *segment = target->segments[i];
    if (!*segment || *segment == '.' || strchr(segment, '/'))
      return false;
    int length = snprintf(path + used, size - used, "%s%s", used ? "/" : "", segment);
    if (length < 0 || (size_t)length >= size - used)
      return false;
    used += (size_t)length;
  }
  return true;
}

/* Opens a path beneath `folder`. The kernel refuses every way out (openat2, Linux 5.6); where it has no openat2, no link is followed. */
static int open_beneath(int folder, const char *path) {
  struct open_how how = {.flags = O_RDONLY | O_CLOEXEC | O_NONBLOCK, .resolve = RESOLVE_BENEATH | RESOLVE_NO_MAGICLINKS};
  int fd = (int)syscall(SYS_openat2, folder, path, &how, sizeof how);
  if (fd >= 0 || (errno != ENOSYS && errno != EPERM))
    return fd;
  int at = dup(folder);
  while (at >= 0) {
    char name[256];
    size_t size = strcspn(path, "/");
    if (size >= sizeof name)
      break;
    memcpy(name, path, size);
    name[size] = 0;
    bool last = path[size] == 0;
    fd = openat(at, name, (last ? O_RDONLY | O_NONBLOCK : O_PATH | O_DIRECTORY) | O_NOFOLLOW | O_CLOEXEC);
    close(at);
    if (last || fd < 0)
      return fd;
    at = fd;
    path += size + 1;
  }
  if (at >= 0)
    close(at);
  return -1;
}

/* A viewer's file may be replaced while it is served, so it is read and not mapped: a mapped file that shrinks is a SIGBUS. */
static struct lod_body *read_whole(int fd, size_t size) {
  char *bytes = malloc(size ? size : 1);
  size_t used = 0;
  while (bytes && used < size) {
    ssize_t count = read(fd, bytes + used, size - used);
    if (count < 0 && errno == EINTR)
      continue;
    if (count <= 0)
      break;
    used += (size_t)count;
  }
  if (used == size)
    return lod_body_take(bytes, size);
  free(bytes);
  return NULL;
}

static void read_file(struct lod_exchange *exchange) {
  struct lod_reply *reply = &exchange->reply;
  char path[1024];
  struct stat status;
  int folder = exchange->service->viewer_fd;
  int fd = folder >= 0 && join_path(&exchange->target, path, sizeof path) ? open_beneath(folder, path) : -1;
  if (fd < 0 || fstat(fd, &status) != 0 || !S_ISREG(status.st_mode) || status.st_size > VIEWER_FILE_MAX) {
    lod_reply_problem(reply, 404, "unknown-file",
                      folder < 0 ? "This server was started without a viewer; see --viewer." : "The viewer has no such file.", "");
  } else if (!(reply->body = read_whole(fd, (size_t)status.st_size))) {
    lod_reply_problem(reply, 503, "file-changed", "The file changed while it was read; ask again.", "");
  } else {
    reply->status = 200;
    reply->cache = LOD_CACHE_REVALIDATE;
    reply->type = type_of(path, &reply->compress);
    lod_etag_of_bytes(reply->body->bytes, reply->body->size, reply->etag);
  }
  if (fd >= 0)
    close(fd);
}

void lod_answer_viewer(struct lod_exchange *exchange) {
  exchange->work = read_file;
}

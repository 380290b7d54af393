#include "clients/cli/leftovers.h"

#include <fcntl.h>
#include <string.h>
#include <unistd.h>

enum { DIGEST_HEX = 64, DEPTH_MAX = 32 };

static void collect(const json_t *value, json_t *names, int depth) {
  const char *key;
  json_t *member;
  size_t i;
  if (depth == DEPTH_MAX)
    return;
  json_object_foreach((json_t *)value, key, member) {
    const char *text = json_string_value(member);
    if (strcmp(key, "object") == 0 && text != NULL && strlen(text) == DIGEST_HEX && strspn(text, "0123456789abcdef") == DIGEST_HEX)
      json_object_set_new(names, text, json_true());
    else
      collect(member, names, depth + 1);
  }
  json_array_foreach(value, i, member) collect(member, names, depth + 1);
}

json_t *cli_named_objects(int directory_fd) {
  json_t *names = json_object();
  int fd = openat(directory_fd, "manifest.json", O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
  if (fd < 0)
    return names;
  json_t *manifest = json_loadfd(fd, 0, NULL);
  close(fd);
  if (manifest != NULL && names != NULL)
    collect(manifest, names, 0);
  json_decref(manifest);
  return names;
}

size_t cli_remove_leftovers(int directory_fd, const json_t *before) {
  size_t removed = 0;
  const char *name;
  json_t *ignored, *present = cli_named_objects(directory_fd);
  int objects = openat(directory_fd, "objects", O_RDONLY | O_DIRECTORY | O_CLOEXEC | O_NOFOLLOW);
  /* Without a manifest to go by nothing is known to be left over. */
  if (objects >= 0 && json_object_size(present) > 0) {
    json_object_foreach((json_t *)before, name, ignored) {
      if (json_object_get(present, name) == NULL)
        removed += unlinkat(objects, name, 0) == 0;
    }
  }
  if (objects >= 0)
    close(objects);
  json_decref(present);
  return removed;
}

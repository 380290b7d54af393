#include "codec/export/tree.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "codec/export/interop.h"

enum { HASH_HEX = 64 };

struct export {
  int bake;   /* not owned */
  int output; /* the tree under construction */
  const char *name;
  json_t *manifest;
  struct lod_problem *problem;
};

static enum lod_status io_failed(struct export *e, const char *what, const char *path) {
  return lod_fail(e->problem, LOD_IO, "io", "%s: %s %s: %s", e->name, what, path, strerror(errno));
}

/* ---- files ---- */

static enum lod_status copy_bytes(struct export *e, int from, int to, const char *path) {
  char buffer[65536];
  for (;;) {
    ssize_t got = read(from, buffer, sizeof buffer);
    if (got < 0 && errno == EINTR)
      continue;
    if (got < 0)
      return io_failed(e, "cannot read", path);
    if (got == 0)
      return LOD_OK;
    for (ssize_t done = 0; done < got;) {
      ssize_t put = write(to, buffer + done, (size_t)(got - done));
      if (put < 0 && errno == EINTR)
        continue;
      if (put <= 0)
        return io_failed(e, "cannot write", path);
      done += put;
    }
  }
}

static enum lod_status copy_file(struct export *e, int from_directory, const char *from, const char *to) {
  int in = openat(from_directory, from, O_RDONLY | O_NOFOLLOW | O_CLOEXEC);
  if (in < 0)
    return errno == ENOENT ? lod_fail(e->problem, LOD_BAD_INPUT, "missing-object", "The bake has no %s, which its manifest names", from)
                           : io_failed(e, "cannot open", from);
  struct stat facts;
  if (fstat(in, &facts) != 0 || !S_ISREG(facts.st_mode)) {
    close(in);
    return lod_fail(e->problem, LOD_BAD_INPUT, "missing-object", "%s is not a plain file", from);
  }
  int out = openat(e->output, to, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0644);
  if (out < 0) {
    bool there = errno == EEXIST; /* an object that is named twice */
    close(in);
    return there ? LOD_OK : io_failed(e, "cannot make", to);
  }
  enum lod_status status = copy_bytes(e, in, out, to);
  close(in);
  if (close(out) != 0 && status == LOD_OK)
    status = io_failed(e, "cannot write", to);
  return status;
}

/* A second name for a file of the output tree. */
static enum lod_status name_again(struct export *e, const char *from, const char *to) {
  if (linkat(e->output, from, e->output, to, 0) == 0 || errno == EEXIST)
    return LOD_OK;
  return copy_file(e, e->output, from, to);
}

static enum lod_status make_directory(struct export *e, const char *path) {
  return mkdirat(e->output, path, 0755) == 0 || errno == EEXIST ? LOD_OK : io_failed(e, "cannot make", path);
}

static enum lod_status write_text(struct export *e, const char *path, const char *text, size_t size) {
  int out = openat(e->output, path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (out < 0)
    return io_failed(e, "cannot make", path);
  FILE *file = fdopen(out, "wb");
  bool good = file != NULL && fwrite(text, 1, size, file) == size;
  if (file == NULL)
    close(out);
  else
    good = fclose(file) == 0 && good;
  return good ? LOD_OK : io_failed(e, "cannot write", path);
}

/* ---- what the manifest names ---- */

static bool is_hash(const char *text) {
  return text != NULL && strlen(text) == HASH_HEX && strspn(text, "0123456789abcdef") == HASH_HEX;
}

/* Of a family: becomes a folder. */
static bool is_plain_name(const char *text) {
  return text[0] != '\0' && text[0] != '.' && strlen(text) <= 64 &&
         strspn(text, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.") == strlen(text);
}

/* An object of the bake; as: its path in the tree, NULL = its own name. */
static enum lod_status copy_named(struct export *e, const char *hash, const char *as) {
  if (!is_hash(hash))
    return lod_fail(e->problem, LOD_BAD_INPUT, "manifest", "The manifest names an object that is not 64 hexadecimal digits");
  char path[8 + HASH_HEX + 1];
  snprintf(path, sizeof path, "objects/%s", hash);
  return copy_file(e, e->bake, path, as == NULL ? hash : as);
}

/* The same beneath objects/, and under the name `as` too unless that is NULL. */
static enum lod_status copy_object(struct export *e, json_t *owner, const char *as) {
  const char *hash = json_string_value(json_object_get(owner, "object"));
  char path[8 + HASH_HEX + 1];
  snprintf(path, sizeof path, "objects/%.*s", HASH_HEX, hash == NULL ? "" : hash);
  LOD_TRY(copy_named(e, hash, path));
  return as != NULL ? name_again(e, path, as) : LOD_OK;
}

static enum lod_status export_level(struct export *e, const char *family, size_t number, json_t *level) {
  char path[160];
  snprintf(path, sizeof path, "families/%s/%zu.glb", family, number);
  LOD_TRY(copy_object(e, level, path));
  json_t *delta = json_object_get(level, "delta");
  if (delta == NULL)
    return LOD_OK;
  snprintf(path, sizeof path, "families/%s/%zu.delta.bin", family, number);
  LOD_TRY(copy_object(e, delta, path));
  json_t *units = json_object_get(delta, "units");
  if (units == NULL)
    return LOD_OK;
  snprintf(path, sizeof path, "families/%s/%zu.units.bin", family, number);
  return copy_object(e, units, path);
}

static enum lod_status export_family(struct export *e, const char *family, json_t *json) {
  char path[160];
  size_t i;
  json_t *element;
  if (!is_plain_name(family))
    return lod_fail(e->problem, LOD_BAD_INPUT, "manifest", "The manifest names a family \"%.60s\", which cannot be a folder", family);
  snprintf(path, sizeof path, "families/%s", family);
  LOD_TRY(make_directory(e, path));
  json_array_foreach(json_object_get(json, "levels"), i, element) LOD_TRY(export_level(e, family, i, element));
  json_array_foreach(json_object_get(e->manifest, "textures"), i, element) {
    const char *hash = json_string_value(json_object_get(element, "object"));
    if (!is_hash(hash))
      return lod_fail(e->problem, LOD_BAD_INPUT, "manifest", "The manifest names a texture that is not 64 hexadecimal digits");
    snprintf(path, sizeof path, "families/%s/%s", family, hash);
    LOD_TRY(copy_object(e, element, path));
  }
  return LOD_OK;
}

/* ---- index.html ---- */

static void put_escaped(FILE *out, const char *text) {
  for (; text != NULL && *text != '\0'; text++) {
    if (*text == '<' || *text == '>' || *text == '&' || *text == '"' || *text == '\'')
      fprintf(out, "&#%d;", *text);
    else
      fputc(*text, out);
  }
}

static long long integer_of(json_t *object, const char *key) {
  return (long long)json_integer_value(json_object_get(object, key));
}

static void put_family(FILE *out, const char *family, json_t *json) {
  fprintf(out, "<h2>%s</h2>\n<table>\n<tr><th>level<th>triangles<th>vertices<th>edges<th>points<th>certified error<th>bytes</tr>\n",
          family);
  size_t i;
  json_t *level;
  json_array_foreach(json_object_get(json, "levels"), i, level)
      fprintf(out, "<tr><td><a href=\"families/%s/%zu.glb\">%zu</a><td>%lld<td>%lld<td>%lld<td>%lld<td>%.4g<td>%lld</tr>\n", family, i, i,
              integer_of(level, "triangles"), integer_of(level, "vertices"), integer_of(level, "edges"), integer_of(level, "points"),
              json_number_value(json_object_get(level, "error")), integer_of(level, "bytes"));
  fprintf(out, "</table>\n");
}

static void put_page(FILE *out, json_t *manifest, bool viewer) {
  json_t *source = json_object_get(manifest, "source"), *family;
  const char *name;
  fprintf(out, "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n"
               "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>");
  put_escaped(out, json_string_value(json_object_get(manifest, "id")));
  fprintf(out, "</title>\n<style>body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
               "table{border-collapse:collapse}td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #ccc}</style>\n<h1>");
  put_escaped(out, json_string_value(json_object_get(manifest, "id")));
  fprintf(out, "</h1>\n<p>%lld triangles in the source, diagonal %.6g model units. <a href=\"manifest.json\">manifest.json</a>",
          integer_of(source, "triangles"), json_number_value(json_object_get(source, "diagonal")));
  if (viewer)
    fprintf(out, ", <a href=\"viewer/index.html\">viewer</a>");
  fprintf(out, "</p>\n");
  json_object_foreach(json_object_get(manifest, "families"), name, family) put_family(out, name, family);
  fprintf(out, "<p>A certified error is an upper bound of the two-sided Hausdorff distance to the source, in model units.</p>\n</html>\n");
}

static enum lod_status write_page(struct export *e, bool viewer) {
  char *text = NULL;
  size_t size = 0;
  FILE *out = open_memstream(&text, &size);
  if (out == NULL)
    return lod_fail_memory(e->problem);
  put_page(out, e->manifest, viewer);
  enum lod_status status = fclose(out) == 0 ? write_text(e, "index.html", text, size) : lod_fail_memory(e->problem);
  free(text);
  return status;
}

/* ---- the viewer ---- */

enum { VIEWER_DEPTH = 4 };

static enum lod_status copy_folder(struct export *e, int from, const char *to, int depth) {
  LOD_TRY(make_directory(e, to));
  int duplicate = fcntl(from, F_DUPFD_CLOEXEC, 0);
  DIR *folder = duplicate < 0 ? NULL : fdopendir(duplicate);
  if (folder == NULL) {
    if (duplicate >= 0)
      close(duplicate);
    return io_failed(e, "cannot list", to);
  }
  enum lod_status status = LOD_OK;
  for (struct dirent *entry = readdir(folder); entry != NULL && status == LOD_OK; entry = readdir(folder)) {
    char path[1024];
    struct stat facts;
    if (entry->d_name[0] == '.' || fstatat(from, entry->d_name, &facts, AT_SYMLINK_NOFOLLOW) != 0 ||
        snprintf(path, sizeof path, "%s/%s", to, entry->d_name) >= (int)sizeof path)
      continue;
    if (S_ISREG(facts.st_mode)) {
      status = copy_file(e, from, entry->d_name, path);
    } else if (S_ISDIR(facts.st_mode) && depth < VIEWER_DEPTH) {
      int inner = openat(from, entry->d_name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
      status = inner < 0 ? io_failed(e, "cannot open", path) : copy_folder(e, inner, path, depth + 1);
      if (inner >= 0)
        close(inner);
    }
  }
  closedir(folder);
  return status;
}

static enum lod_status copy_viewer(struct export *e, const char *directory) {
  int from = open(directory, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (from < 0)
    return io_failed(e, "cannot open", directory);
  enum lod_status status = copy_folder(e, from, "viewer", 0);
  close(from);
  return status;
}

/* ---- the whole ---- */

static enum lod_status read_manifest(struct export *e) {
  int fd = openat(e->bake, "manifest.json", O_RDONLY | O_NOFOLLOW | O_CLOEXEC);
  if (fd < 0)
    return lod_fail(e->problem, LOD_BAD_INPUT, "manifest", "There is no manifest.json: this is not a finished bake");
  json_error_t error;
  e->manifest = json_loadfd(fd, 0, &error);
  close(fd);
  if (!json_is_object(json_object_get(e->manifest, "families")))
    return lod_fail(e->problem, LOD_BAD_INPUT, "manifest", "manifest.json is not a manifest: %s",
                    e->manifest == NULL ? error.text : "it has no families");
  return LOD_OK;
}

/* One document over levels beside it. */
static enum lod_status fill_interop(struct export *e, enum lod_export_format format) {
  struct lod_interop_level levels[LOD_INTEROP_LEVELS];
  uint32_t count = lod_interop_choose(e->manifest, levels);
  if (count == 0)
    return lod_fail(e->problem, LOD_BAD_INPUT, "manifest", "The manifest names no level that is a GLB");
  for (uint32_t i = 0; i < count; i++) {
    snprintf(levels[i].uri, sizeof levels[i].uri, "%u.glb", i);
    LOD_TRY(copy_named(e, levels[i].object, levels[i].uri));
  }
  size_t i;
  json_t *texture;
  json_array_foreach(json_object_get(e->manifest, "textures"), i, texture)
      LOD_TRY(copy_named(e, json_string_value(json_object_get(texture, "object")), NULL));
  char *text = NULL;
  LOD_TRY(format == LOD_EXPORT_TILES ? lod_interop_tileset(e->manifest, levels, count, &text, e->problem)
                                     : lod_interop_gltf(e->manifest, levels, count, e->bake, &text, e->problem));
  enum lod_status status = write_text(e, format == LOD_EXPORT_TILES ? "tileset.json" : "model.gltf", text, strlen(text));
  free(text);
  return status;
}

static enum lod_status fill(struct export *e, enum lod_export_format format, const char *viewer_directory) {
  if (format != LOD_EXPORT_STATIC)
    return fill_interop(e, format);
  const char *name;
  json_t *family;
  LOD_TRY(make_directory(e, "objects"));
  LOD_TRY(make_directory(e, "families"));
  json_object_foreach(json_object_get(e->manifest, "families"), name, family) LOD_TRY(export_family(e, name, family));
  static const char *const kDocuments[] = {"tileset", "gltf", "materials"};
  for (size_t i = 0; i < sizeof kDocuments / sizeof kDocuments[0]; i++) {
    json_t *document = json_object_get(e->manifest, kDocuments[i]);
    if (document != NULL)
      LOD_TRY(copy_object(e, document, NULL));
  }
  if (viewer_directory != NULL)
    LOD_TRY(copy_viewer(e, viewer_directory));
  LOD_TRY(write_page(e, viewer_directory != NULL));
  return copy_file(e, e->bake, "manifest.json", "manifest.json");
}

/* Removes what an attempt left. Only below a directory that this attempt made. */
static void remove_tree(int parent, const char *name) {
  int directory = openat(parent, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  DIR *folder = directory < 0 ? NULL : fdopendir(directory);
  if (folder == NULL) {
    if (directory >= 0)
      close(directory);
    return;
  }
  for (struct dirent *entry = readdir(folder); entry != NULL; entry = readdir(folder)) {
    if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0)
      continue;
    if (unlinkat(directory, entry->d_name, 0) != 0)
      remove_tree(directory, entry->d_name);
  }
  closedir(folder);
  unlinkat(parent, name, AT_REMOVEDIR);
}

enum lod_status lod_export_tree(int bake_directory_fd, enum lod_export_format format, const char *output, const char *viewer_directory,
                                struct lod_problem *problem) {
  struct export e = {.bake = bake_directory_fd, .output = -1, .name = output, .problem = problem};
  char path[4096];
  size_t length = strlen(output);
  while (length > 1 && output[length - 1] == '/')
    length--;
  if (length == 0 || snprintf(path, sizeof path, "%.*s.XXXXXX", (int)length, output) >= (int)sizeof path)
    return lod_fail(problem, LOD_BAD_INPUT, "output", "\"%.60s\" cannot be the name of a directory", output);
  enum lod_status status = read_manifest(&e);
  if (status == LOD_OK && mkdtemp(path) == NULL)
    status = io_failed(&e, "cannot make", path);
  else if (status == LOD_OK) {
    e.output = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    status = e.output < 0 ? io_failed(&e, "cannot open", path) : fill(&e, format, viewer_directory);
    char final[4096];
    snprintf(final, sizeof final, "%.*s", (int)length, output);
    /* mkdtemp makes it private. rename() takes the place of an empty directory and of nothing else. */
    if (status == LOD_OK && (fchmod(e.output, 0755) != 0 || rename(path, final) != 0))
      status = errno == ENOTEMPTY || errno == EEXIST || errno == ENOTDIR
                   ? lod_fail(problem, LOD_BAD_INPUT, "output", "%s is there already and is not an empty directory", final)
                   : io_failed(&e, "cannot rename to", final);
    if (e.output >= 0)
      close(e.output);
    if (status != LOD_OK)
      remove_tree(AT_FDCWD, path);
  }
  json_decref(e.manifest);
  return status;
}

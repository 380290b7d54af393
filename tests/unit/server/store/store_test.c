/* The store: whole revisions or none, shared objects, readers, restarts, kills, a full disk. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include <dirent.h>
#include <errno.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <sys/mount.h>
#include <sys/wait.h>
#include <time.h>

#include <sqlite3.h>

#include "server/store/catalog.h"
#include "tests/unit/server/store/fixture.h"

static enum lod_status put(struct fixture *fixture, const char *id, const char *revision, const struct bake_level *levels, size_t count,
                           struct lod_problem *problem) {
  int fd = bake_folder(fixture);
  assert_int_equal(write_bake(fd, id, revision, levels, count, NULL), 0);
  enum lod_status status = lod_store_commit_bake(fixture->store, id, fd, problem);
  close(fd);
  return status;
}

static size_t count_files(struct fixture *fixture, const char *folder) {
  char path[160];
  size_t count = 0;
  snprintf(path, sizeof path, "%s/%s", fixture->path, folder);
  DIR *list = opendir(path);
  if (list == NULL)
    return 0;
  for (const struct dirent *file; (file = readdir(list)) != NULL;)
    count += file->d_name[0] != '.';
  closedir(list);
  return count;
}

static size_t count_objects(struct fixture *fixture) {
  size_t count = 0;
  char name[16];
  for (int i = 0; i < 256; i++) {
    snprintf(name, sizeof name, "objects/%02x", i);
    count += count_files(fixture, name);
  }
  return count;
}

/* Every level's object is there, with the hash that names it. */
static void check_whole(struct lod_store *store, const struct lod_stored_model *model) {
  for (uint32_t f = 0; f < model->family_count; f++)
    for (uint32_t i = 0; i < model->families[f].level_count; i++) {
      const struct lod_stored_level *level = &model->families[f].levels[i];
      struct lod_problem problem = {0};
      struct lod_object *object;
      char digest[LOD_SHA256_HEX + 1];
      assert_int_equal(lod_store_object_open(store, level->sha256, &object, &problem), LOD_OK);
      assert_non_null(object);
      lod_sha256_text(object->bytes, object->size, digest);
      assert_string_equal(digest, level->sha256);
      assert_int_equal(object->size, level->facts.bytes);
      lod_store_object_release(object);
    }
}

static const struct bake_level kCube[] = {{"coarse cube", 0}, {"middle cube", 0}, {"fine cube", 0}};
static const struct bake_level kOther[] = {{"coarse other", 0}, {"middle cube", 0}};

static void what_was_committed_is_there_after_reopening(void **state) {
  struct fixture *fixture = *state;
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  for (int round = 0; round < 2; round++) {
    struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
    assert_non_null(model);
    assert_string_equal(model->id, "cube");
    assert_string_equal(model->revision, "r1");
    assert_int_equal(model->family_count, 1);
    assert_string_equal(model->families[0].name, "cluster");
    assert_true(model->families[0].nested);
    assert_int_equal(model->families[0].level_count, 3);
    assert_true(model->families[0].levels[1].facts.error == 0.05);
    assert_true(model->families[0].levels[1].facts.cell == 0.5);
    assert_int_equal(model->families[0].levels[1].facts.triangles, 20);
    assert_string_equal(model->families[0].levels[1].type, "model/gltf-binary");
    assert_int_equal(model->triangles, 12);
    assert_int_equal(model->bytes, strlen("coarse cube") + strlen("middle cube") + strlen("fine cube"));
    assert_true(model->diagonal == 1.7320508075688772);
    assert_int_equal(strlen(model->manifest_etag), 66);
    assert_true(strlen(model->manifest) == model->manifest_size);
    assert_true(model->created > 1e9);
    check_whole(fixture->store, model);
    lod_store_model_release(model);
    reopen(fixture);
  }
  assert_null(lod_store_model_open(fixture->store, "cub"));
  struct lod_object *object;
  char nowhere[65];
  memset(nowhere, 'a', 64);
  nowhere[64] = 0;
  assert_int_equal(lod_store_object_open(fixture->store, nowhere, &object, NULL), LOD_OK);
  assert_null(object);
}

static void an_unchanged_id_leaves_the_manifest_byte_for_byte(void **state) {
  struct fixture *fixture = *state;
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  char *text = bake_manifest("cube", "r1", kCube, 3, NULL);
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
  assert_string_equal(model->manifest, text);
  lod_store_model_release(model);
  free(text);
}

static void another_id_in_the_manifest_is_replaced(void **state) {
  struct fixture *fixture = *state;
  int fd = bake_folder(fixture);
  assert_int_equal(write_bake(fd, "liar", "r1", kCube, 3, NULL), 0);
  assert_int_equal(lod_store_commit_bake(fixture->store, "cube", fd, NULL), LOD_OK);
  close(fd);
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
  assert_non_null(strstr(model->manifest, "\"id\":\"cube\""));
  assert_null(strstr(model->manifest, "liar"));
  assert_true(model->families[0].levels[2].facts.error == 0.1 / 3); /* rewriting must not round */
  lod_store_model_release(model);
  reopen(fixture);
  model = lod_store_model_open(fixture->store, "cube");
  assert_true(model->families[0].levels[2].facts.error == 0.1 / 3);
  lod_store_model_release(model);
  assert_null(lod_store_model_open(fixture->store, "liar"));
}

static void two_models_share_an_object_until_both_are_gone(void **state) {
  struct fixture *fixture = *state;
  bool existed;
  assert_int_equal(lod_store_model_delete(fixture->store, "cube", NULL, &existed, NULL), LOD_OK);
  assert_false(existed);
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  assert_int_equal(put(fixture, "other", "r1", kOther, 2, NULL), LOD_OK);
  assert_int_equal(count_objects(fixture), 4);
  assert_int_equal(lod_store_bytes(fixture->store), 11 + 11 + 9 + 12);
  assert_int_equal(lod_store_model_delete(fixture->store, "cube", NULL, &existed, NULL), LOD_OK);
  assert_true(existed);
  assert_int_equal(count_objects(fixture), 2);
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "other");
  check_whole(fixture->store, model);
  lod_store_model_release(model);
  reopen(fixture);
  assert_int_equal(count_objects(fixture), 2);
  assert_int_equal(lod_store_model_delete(fixture->store, "other", NULL, &existed, NULL), LOD_OK);
  assert_int_equal(count_objects(fixture), 0);
  assert_int_equal(lod_store_bytes(fixture->store), 0);
  assert_int_equal(lod_store_model_delete(fixture->store, "other", NULL, &existed, NULL), LOD_OK);
  assert_false(existed);
}

static void wait_for_objects(struct fixture *fixture, size_t count) {
  for (int i = 0; i < 500 && count_objects(fixture) != count; i++)
    nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
  assert_int_equal(count_objects(fixture), count);
}

static void a_reader_keeps_what_it_holds_when_the_model_is_deleted(void **state) {
  struct fixture *fixture = *state;
  bool existed;
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
  struct lod_object *first, *late;
  assert_int_equal(lod_store_object_open(fixture->store, model->families[0].levels[0].sha256, &first, NULL), LOD_OK);
  assert_int_equal(lod_store_model_delete(fixture->store, "cube", NULL, &existed, NULL), LOD_OK);
  assert_null(lod_store_model_open(fixture->store, "cube"));
  /* The revision that is held still opens objects that were never opened before. */
  check_whole(fixture->store, model);
  assert_int_equal(lod_store_object_open(fixture->store, model->families[0].levels[2].sha256, &late, NULL), LOD_OK);
  lod_store_model_release(model);
  wait_for_objects(fixture, 0);
  assert_memory_equal(first->bytes, "coarse cube", 11);
  assert_memory_equal(late->bytes, "fine cube", 9);
  lod_store_object_release(first);
  lod_store_object_release(late);
}

static void the_old_revision_serves_its_reader_beside_the_new_one(void **state) {
  struct fixture *fixture = *state;
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  uint64_t generation = lod_store_generation(fixture->store);
  struct lod_stored_model *old = lod_store_model_open(fixture->store, "cube");
  assert_int_equal(put(fixture, "cube", "r2", kOther, 2, NULL), LOD_OK);
  assert_true(lod_store_generation(fixture->store) > generation);
  struct lod_stored_model *new = lod_store_model_open(fixture->store, "cube");
  assert_string_equal(old->revision, "r1");
  assert_string_equal(new->revision, "r2");
  check_whole(fixture->store, old);
  check_whole(fixture->store, new);
  /* The first revision comes back while its objects wait to be unlinked. */
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  lod_store_model_release(old);
  lod_store_model_release(new);
  wait_for_objects(fixture, 3);
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
  check_whole(fixture->store, model);
  lod_store_model_release(model);
  assert_int_equal(lod_store_model_count(fixture->store), 1);
}

static void the_list_is_in_id_order_and_pages(void **state) {
  struct fixture *fixture = *state;
  static const char *const kIds[] = {"m", "b", "z", "a", "c.1", "B"};
  struct lod_stored_model *models[8];
  for (size_t i = 0; i < 6; i++)
    assert_int_equal(put(fixture, kIds[i], "r1", kCube, 3, NULL), LOD_OK);
  bool existed;
  assert_int_equal(lod_store_model_delete(fixture->store, "b", NULL, &existed, NULL), LOD_OK);
  assert_int_equal(lod_store_model_list(fixture->store, NULL, 8, models), 5);
  static const char *const kOrder[] = {"B", "a", "c.1", "m", "z"};
  for (size_t i = 0; i < 5; i++) {
    assert_string_equal(models[i]->id, kOrder[i]);
    lod_store_model_release(models[i]);
  }
  assert_int_equal(lod_store_model_list(fixture->store, "b", 2, models), 2);
  assert_string_equal(models[0]->id, "c.1");
  assert_string_equal(models[1]->id, "m");
  lod_store_model_release(models[0]);
  lod_store_model_release(models[1]);
  assert_int_equal(lod_store_model_list(fixture->store, "z", 2, models), 0);
}

static void ids_that_could_escape_are_refused(void **state) {
  struct fixture *fixture = *state;
  static const char *const kBad[] = {"", ".", "..", "a/b", "../x", "-x", ".x", "a b", "a%2f", "\xc3\xa4", "a\n"};
  for (size_t i = 0; i < sizeof kBad / sizeof kBad[0]; i++)
    assert_false(lod_model_id_valid(kBad[i]));
  assert_false(lod_model_id_valid(NULL));
  char longest[LOD_MODEL_ID_MAX + 2];
  memset(longest, 'a', sizeof longest);
  longest[LOD_MODEL_ID_MAX] = 0;
  assert_true(lod_model_id_valid(longest));
  longest[LOD_MODEL_ID_MAX] = 'a';
  longest[LOD_MODEL_ID_MAX + 1] = 0;
  assert_false(lod_model_id_valid(longest));
  assert_true(lod_model_id_valid("Bunny_2.ply-x"));
  struct lod_problem problem = {0};
  assert_int_equal(put(fixture, "../x", "r1", kCube, 3, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "bad-id");
}

/* ---- what a hostile worker might leave ---- */

struct lie {
  const char *what, *type;
  void (*tell)(int folder_fd, int objects_fd, const char *name);
};
static void lie_missing(int folder_fd, int objects_fd, const char *name) {
  (void)folder_fd;
  unlinkat(objects_fd, name, 0);
}
static void lie_content(int folder_fd, int objects_fd, const char *name) {
  (void)folder_fd;
  assert_int_equal(write_file_at(objects_fd, name, "COARSE cube", 11), 0);
}
static void lie_longer(int folder_fd, int objects_fd, const char *name) {
  (void)folder_fd;
  assert_int_equal(write_file_at(objects_fd, name, "coarse cube!", 12), 0);
}
static void lie_empty(int folder_fd, int objects_fd, const char *name) {
  (void)folder_fd;
  assert_int_equal(write_file_at(objects_fd, name, "", 0), 0);
}
static void lie_symlink(int folder_fd, int objects_fd, const char *name) {
  (void)folder_fd;
  unlinkat(objects_fd, name, 0);
  assert_int_equal(write_file_at(objects_fd, "there", "coarse cube", 11), 0);
  assert_int_equal(symlinkat("there", objects_fd, name), 0);
}
static void lie_hardlink(int folder_fd, int objects_fd, const char *name) {
  assert_int_equal(linkat(objects_fd, name, folder_fd, "second-name", 0), 0);
}
static void lie_fifo(int folder_fd, int objects_fd, const char *name) {
  (void)folder_fd;
  unlinkat(objects_fd, name, 0);
  assert_int_equal(mkfifoat(objects_fd, name, 0600), 0);
}
static void lie_folder(int folder_fd, int objects_fd, const char *name) {
  (void)folder_fd;
  unlinkat(objects_fd, name, 0);
  assert_int_equal(mkdirat(objects_fd, name, 0700), 0);
}
static void lie_manifest_link(int folder_fd, int objects_fd, const char *name) {
  (void)objects_fd, (void)name;
  unlinkat(folder_fd, "manifest.json", 0);
  assert_int_equal(symlinkat("/etc/passwd", folder_fd, "manifest.json"), 0);
}
static void lie_no_manifest(int folder_fd, int objects_fd, const char *name) {
  (void)objects_fd, (void)name;
  unlinkat(folder_fd, "manifest.json", 0);
}
static void lie_objects_link(int folder_fd, int objects_fd, const char *name) {
  (void)objects_fd, (void)name;
  assert_int_equal(renameat(folder_fd, "objects", folder_fd, "elsewhere"), 0);
  assert_int_equal(symlinkat("elsewhere", folder_fd, "objects"), 0);
}
static const struct lie kLies[] = {
    {"an object that is missing", "bad-object", lie_missing},
    {"an object with other content", "bad-object", lie_content},
    {"an object that is longer", "bad-object", lie_longer},
    {"an empty object", "bad-object", lie_empty},
    {"a symbolic link", "bad-object", lie_symlink},
    {"a second name", "bad-object", lie_hardlink},
    {"a FIFO", "bad-object", lie_fifo},
    {"a folder", "bad-object", lie_folder},
    {"a manifest that is a link", "bad-manifest", lie_manifest_link},
    {"no manifest", "bad-manifest", lie_no_manifest},
    {"objects behind a link", "bad-object", lie_objects_link},
};

static void a_bake_that_lies_changes_nothing(void **state) {
  struct fixture *fixture = *state;
  assert_int_equal(put(fixture, "cube", "r1", kOther, 2, NULL), LOD_OK);
  uint64_t generation = lod_store_generation(fixture->store);
  char name[LOD_SHA256_HEX + 1];
  lod_sha256_text("coarse cube", 11, name);
  for (size_t i = 0; i < sizeof kLies / sizeof kLies[0]; i++) {
    struct lod_problem problem = {0};
    int fd = bake_folder(fixture);
    assert_int_equal(write_bake(fd, "cube", "r2", kCube, 3, NULL), 0);
    int objects_fd = openat(fd, "objects", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    kLies[i].tell(fd, objects_fd, name);
    if (lod_store_commit_bake(fixture->store, "cube", fd, &problem) != LOD_BAD_INPUT)
      fail_msg("accepted: %s", kLies[i].what);
    assert_string_equal(problem.type, kLies[i].type);
    close(objects_fd);
    close(fd);
  }
  assert_int_equal(lod_store_generation(fixture->store), generation);
  assert_int_equal(count_objects(fixture), 2);
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
  assert_string_equal(model->revision, "r1");
  check_whole(fixture->store, model);
  lod_store_model_release(model);
}

static void files_that_the_manifest_does_not_name_stay_outside(void **state) {
  struct fixture *fixture = *state;
  int fd = bake_folder(fixture);
  assert_int_equal(write_bake(fd, "cube", "r1", kCube, 3, "a picture"), 0);
  int objects_fd = openat(fd, "objects", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  char name[LOD_SHA256_HEX + 1];
  lod_sha256_text("junk", 4, name);
  assert_int_equal(write_file_at(objects_fd, name, "junk", 4), 0);
  assert_int_equal(lod_store_commit_bake(fixture->store, "cube", fd, NULL), LOD_OK);
  assert_int_equal(count_objects(fixture), 4);
  struct lod_object *object;
  assert_int_equal(lod_store_object_open(fixture->store, name, &object, NULL), LOD_OK);
  assert_null(object);
  lod_sha256_text("a picture", 9, name);
  assert_int_equal(lod_store_object_open(fixture->store, name, &object, NULL), LOD_OK);
  assert_string_equal(object->type, "image/png");
  lod_store_object_release(object);
  close(objects_fd);
  close(fd);
}

/* The cube with a delta from its coarsest level on. */
static void write_bake_with_delta(int folder_fd, const char *digest) {
  char name[80], with[8192];
  assert_int_equal(write_bake(folder_fd, "cube", "r1", kCube, 3, NULL), 0);
  char *text = bake_manifest("cube", "r1", kCube, 3, NULL);
  size_t before = (size_t)(strstr(text, "\"cell\"") - text);
  snprintf(with, sizeof with, "%.*s\"delta\":{\"to\":1,\"bytes\":7,\"object\":\"%s\"},%s", (int)before, text, digest, text + before);
  free(text);
  snprintf(name, sizeof name, "objects/%s", digest);
  assert_int_equal(write_file_at(folder_fd, name, "a delta", 7), 0);
  assert_int_equal(write_file_at(folder_fd, "manifest.json", with, strlen(with)), 0);
}

/* A delta's type is not written down; it must mean the same when the catalogue is read again. */
static void a_delta_is_an_object_that_later_bakes_may_share(void **state) {
  struct fixture *fixture = *state;
  char digest[LOD_SHA256_HEX + 1];
  lod_sha256_text("a delta", 7, digest);
  for (int round = 0; round < 2; round++) {
    int fd = bake_folder(fixture);
    write_bake_with_delta(fd, digest);
    struct lod_problem problem = {0};
    if (lod_store_commit_bake(fixture->store, round == 0 ? "cube" : "again", fd, &problem) != LOD_OK)
      fail_msg("%s", problem.detail);
    close(fd);
    reopen(fixture);
  }
  struct lod_object *object;
  assert_int_equal(lod_store_object_open(fixture->store, digest, &object, NULL), LOD_OK);
  assert_string_equal(object->type, "application/vnd.lodestream.delta");
  lod_store_object_release(object);
}

static void a_delta_is_known_by_the_level_that_it_starts_from(void **state) {
  struct fixture *fixture = *state;
  char digest[LOD_SHA256_HEX + 1];
  int fd = bake_folder(fixture);
  lod_sha256_text("a delta", 7, digest);
  write_bake_with_delta(fd, digest);
  assert_int_equal(lod_store_commit_bake(fixture->store, "cube", fd, NULL), LOD_OK);
  close(fd);
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
  assert_string_equal(model->families[0].levels[0].delta, digest);
  assert_int_equal(model->families[0].levels[0].delta_bytes, 7);
  assert_string_equal(model->families[0].levels[1].delta, "");
  assert_string_equal(model->families[0].levels[0].first, "");
  lod_store_model_release(model);
}

static void a_delta_that_does_not_lead_to_the_next_level_is_refused(void **state) {
  struct fixture *fixture = *state;
  static const struct {
    const char *good, *bad;
  } kCases[] = {
      {"\"delta\":{\"to\":1", "\"delta\":{\"to\":2"},
      {"\"delta\":{\"to\":1", "\"delta\":{\"to\":0"},
      {"\"delta\":{\"to\":1,\"bytes\":7", "\"delta\":{\"to\":1,\"bytes\":-7"},
      {"\"delta\":{\"to\":1", "\"first\":{\"type\":\"text/html\",\"to\":1"},
      {"\"delta\":{\"to\":1,\"bytes\":7,\"object\":\"", "\"delta\":{\"to\":1,\"bytes\":7,\"object\":\"x"},
  };
  char digest[LOD_SHA256_HEX + 1], text[8192];
  lod_sha256_text("a delta", 7, digest);
  for (size_t i = 0; i < sizeof kCases / sizeof *kCases; i++) {
    struct lod_problem problem = {0};
    int fd = bake_folder(fixture);
    write_bake_with_delta(fd, digest);
    int file = openat(fd, "manifest.json", O_RDONLY | O_CLOEXEC);
    ssize_t size = read(file, text, sizeof text - 1);
    close(file);
    assert_true(size > 0);
    text[size] = '\0';
    char *at = strstr(text, kCases[i].good);
    assert_non_null(at);
    char changed[8192];
    snprintf(changed, sizeof changed, "%.*s%s%s", (int)(at - text), text, kCases[i].bad, at + strlen(kCases[i].good));
    assert_int_equal(write_file_at(fd, "manifest.json", changed, strlen(changed)), 0);
    assert_int_equal(lod_store_commit_bake(fixture->store, "cube", fd, &problem), LOD_BAD_INPUT);
    assert_string_equal(problem.type, "bad-manifest");
    close(fd);
  }
}

static void a_bake_over_the_quota_is_refused_and_replacing_is_not(void **state) {
  struct fixture *fixture = *state;
  struct lod_problem problem = {0};
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK); /* 31 bytes */
  lod_store_set_quota(fixture->store, 35);
  assert_int_equal(put(fixture, "other", "r1", kOther, 2, &problem), LOD_LIMIT); /* 12 more, 11 shared */
  assert_string_equal(problem.type, "quota");
  assert_int_equal(count_objects(fixture), 3);
  assert_null(lod_store_model_open(fixture->store, "other"));
  assert_int_equal(put(fixture, "cube", "r2", kOther, 2, NULL), LOD_OK); /* 23 in all */
  assert_int_equal(count_objects(fixture), 2);
}

static void a_store_is_held_by_one_process(void **state) {
  struct fixture *fixture = *state;
  struct lod_store *second;
  struct lod_problem problem = {0};
  assert_int_equal(lod_store_open(fixture->path, &second, &problem), LOD_IO);
  assert_string_equal(problem.type, "store-locked");
  assert_null(second);
}

static void leftovers_are_swept_at_the_next_start(void **state) {
  struct fixture *fixture = *state;
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  int fd = lod_store_directory_fd(fixture->store);
  assert_int_equal(write_file_at(fd, "objects/00/0000000000000000000000000000000000000000000000000000000000000000", "x", 1), 0);
  assert_int_equal(mkdirat(fd, "work/17", 0700), 0);
  char deep[16] = "work/17/d";
  for (int i = 0; i < 3; i++) { /* deeper than a path may be long: made by moving what is there into a new folder */
    for (int k = 0; k < 300; k++) {
      assert_int_equal(mkdirat(fd, "work/17/new", 0700), 0);
      if (i + k > 0)
        assert_int_equal(renameat(fd, deep, fd, "work/17/new/d"), 0);
      assert_int_equal(renameat(fd, "work/17/new", fd, deep), 0);
    }
    assert_int_equal(write_file_at(fd, "work/17/file", "x", 1), 0);
    assert_int_equal(symlinkat("/etc", fd, "work/17/link"), 0);
    if (i < 2) {
      unlinkat(fd, "work/17/file", 0);
      unlinkat(fd, "work/17/link", 0);
    }
  }
  reopen(fixture);
  assert_int_equal(count_objects(fixture), 3);
  assert_int_equal(count_files(fixture, "work"), 0);
  assert_int_equal(access("/etc/passwd", R_OK), 0);
}

static void a_lost_object_is_a_problem_and_a_new_bake_mends_it(void **state) {
  struct fixture *fixture = *state;
  char path[160], name[LOD_SHA256_HEX + 1];
  struct lod_object *object;
  struct lod_problem problem = {0};
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  lod_sha256_text("coarse cube", 11, name);
  snprintf(path, sizeof path, "%s/objects/%.2s/%s", fixture->path, name, name);
  assert_int_equal(unlink(path), 0);
  reopen(fixture);
  assert_int_equal(lod_store_object_open(fixture->store, name, &object, &problem), LOD_IO);
  assert_string_equal(problem.type, "object-missing");
  assert_int_equal(put(fixture, "cube", "r1", kCube, 3, NULL), LOD_OK);
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
  check_whole(fixture->store, model);
  lod_store_model_release(model);
}

static void a_store_that_is_not_one_is_refused_with_a_reason(void **state) {
  struct fixture *fixture = *state;
  struct lod_store *store;
  struct lod_problem problem = {0};
  char path[160];
  snprintf(path, sizeof path, "%s/broken", fixture->root);
  assert_int_equal(mkdir(path, 0700), 0);
  int fd = open(path, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  char junk[4096];
  memset(junk, 'j', sizeof junk);
  assert_int_equal(write_file_at(fd, "catalog.sqlite", junk, sizeof junk), 0);
  close(fd);
  assert_int_equal(lod_store_open(path, &store, &problem), LOD_IO);
  assert_string_equal(problem.type, "store-corrupt");
  problem = (struct lod_problem){0};
  assert_int_equal(lod_store_open("/proc/nowhere/store", &store, &problem), LOD_IO);
  assert_true(lod_store_ready(fixture->store, &problem));
}

/* ---- many threads ---- */

struct crowd {
  struct lod_store *store;
  atomic_bool stop;
  atomic_uint opened;
};

static void *read_always(void *argument) {
  struct crowd *crowd = argument;
  while (!atomic_load(&crowd->stop)) {
    struct lod_stored_model *model = lod_store_model_open(crowd->store, "cube");
    if (model == NULL)
      continue;
    for (uint32_t i = 0; i < model->families[0].level_count; i++) {
      struct lod_object *object = NULL;
      if (lod_store_object_open(crowd->store, model->families[0].levels[i].sha256, &object, NULL) != LOD_OK || object == NULL ||
          object->size != model->families[0].levels[i].facts.bytes)
        abort(); /* a revision that is held must open */
      lod_store_object_release(object);
      atomic_fetch_add(&crowd->opened, 1);
    }
    lod_store_model_release(model);
  }
  return NULL;
}

static void readers_never_meet_a_missing_object_while_revisions_change(void **state) {
  struct fixture *fixture = *state;
  struct crowd crowd = {.store = fixture->store};
  pthread_t threads[3];
  bool existed;
  for (size_t i = 0; i < 3; i++)
    assert_int_equal(pthread_create(&threads[i], NULL, read_always, &crowd), 0);
  for (int i = 0; i < 30; i++) {
    assert_int_equal(put(fixture, "cube", "r1", i % 2 ? kCube : kOther, i % 2 ? 3 : 2, NULL), LOD_OK);
    if (i % 10 == 9)
      assert_int_equal(lod_store_model_delete(fixture->store, "cube", NULL, &existed, NULL), LOD_OK);
  }
  atomic_store(&crowd.stop, true);
  for (size_t i = 0; i < 3; i++)
    pthread_join(threads[i], NULL);
  assert_true(atomic_load(&crowd.opened) > 0);
  wait_for_objects(fixture, 0);
}

/* ---- stores of earlier versions ---- */

static void sql(struct fixture *fixture, const char *text) {
  char path[300];
  sqlite3 *database;
  snprintf(path, sizeof path, "%s/catalog.sqlite", fixture->path);
  assert_int_equal(sqlite3_open(path, &database), SQLITE_OK);
  if (sqlite3_exec(database, text, NULL, NULL, NULL) != SQLITE_OK)
    fail_msg("%s: %s", text, sqlite3_errmsg(database));
  sqlite3_close(database);
}

struct job_facts {
  size_t count;
  struct lod_catalog_job last;
};
static enum lod_status take_job(void *context, const struct lod_catalog_job *job) {
  struct job_facts *facts = context;
  facts->count++;
  facts->last = *job;
  return LOD_OK;
}

/* Version 1 had no column for jobs that add later families. */
static void a_store_of_version_1_is_taken_over_whole(void **state) {
  struct fixture *fixture = *state;
  const struct bake_level levels[] = {{"coarse", 0}, {"fine", 0}};
  assert_int_equal(put(fixture, "cube", "r1", levels, 2, NULL), LOD_OK);
  lod_store_close(fixture->store);
  fixture->store = NULL;
  sql(fixture, "DROP TABLE jobs;"
               "CREATE TABLE jobs (number INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL, name TEXT NOT NULL, format TEXT,"
               " state INTEGER NOT NULL, attempts INTEGER NOT NULL, created REAL NOT NULL, finished REAL NOT NULL,"
               " status INTEGER NOT NULL, type TEXT NOT NULL, detail TEXT NOT NULL);"
               "INSERT INTO jobs VALUES (7, 'cube', 'cube.ply', 'ply', 2, 1, 1e9, 1e9 + 2, 0, '', '');"
               "PRAGMA user_version = 1;");
  for (int round = 0; round < 2; round++) { /* the second time there is nothing to take over */
    reopen(fixture);
    struct lod_stored_model *model = lod_store_model_open(fixture->store, "cube");
    assert_non_null(model);
    assert_string_equal(model->revision, "r1");
    check_whole(fixture->store, model);
    lod_store_model_release(model);
    struct job_facts facts = {0};
    assert_int_equal(lod_catalog_read_jobs(lod_store_catalog(fixture->store), take_job, &facts, NULL), LOD_OK);
    assert_int_equal(facts.count, 1);
    assert_int_equal(facts.last.number, 7);
    assert_int_equal(facts.last.state, 2);
    assert_false(facts.last.later);
    uint64_t last;
    assert_int_equal(lod_catalog_last_job(lod_store_catalog(fixture->store), &last, NULL), LOD_OK);
    assert_int_equal(last, 7); /* numbers are not given twice */
  }
  lod_store_close(fixture->store);
  fixture->store = NULL;
  struct lod_problem problem = {0};
  sql(fixture, "PRAGMA user_version = 99;");
  assert_int_equal(lod_store_open(fixture->path, &fixture->store, &problem), LOD_UNSUPPORTED);
  assert_string_equal(problem.type, "store-newer");
  sql(fixture, "PRAGMA user_version = 2;");
  reopen(fixture);
}

/* ---- kills ---- */

/* Commits bakes of two models in turn, with content that changes, and says so on `out` after each. */
static void commit_until_killed(struct fixture *fixture, int out, unsigned start) {
  static char big[200000];
  for (unsigned i = start;; i++) {
    char revision[32], coarse[32];
    snprintf(revision, sizeof revision, "r%u", i);
    snprintf(coarse, sizeof coarse, "coarse %u", i);
    snprintf(big, sizeof big, "fine %u", i);
    const struct bake_level levels[] = {{coarse, 0}, {"shared", 0}, {big, sizeof big}};
    if (put(fixture, i % 2 ? "odd" : "even", revision, levels, 3, NULL) != LOD_OK || write(out, &i, sizeof i) != sizeof i)
      _exit(1);
  }
}

static unsigned check_after_kill(struct fixture *fixture, unsigned acknowledged) {
  unsigned newest = 0;
  for (unsigned parity = 0; parity < 2; parity++) {
    struct lod_stored_model *model = lod_store_model_open(fixture->store, parity ? "odd" : "even");
    /* The newest acknowledged of each, or a later one whose acknowledgement did not get out. */
    unsigned expected = acknowledged % 2 == parity || acknowledged == 0 ? acknowledged : acknowledged - 1;
    if (model == NULL) {
      assert_true(acknowledged == 0 || expected == 0);
      continue;
    }
    unsigned found = (unsigned)atoi(model->revision + 1);
    assert_true(found >= expected);
    assert_true(found <= acknowledged + 2);
    newest = found > newest ? found : newest;
    check_whole(fixture->store, model);
    lod_store_model_release(model);
  }
  return newest;
}

static void a_kill_at_any_moment_loses_nothing_acknowledged(void **state) {
  struct fixture *fixture = *state;
  unsigned acknowledged = 0, moved = 0;
  const char *kills = getenv("LODESTREAM_TEST_KILLS"); /* the long form: 200 */
  const int rounds = kills ? atoi(kills) : 30;
  srand(20240607);
  for (int round = 0; round < rounds; round++) {
    lod_store_close(fixture->store);
    fixture->store = NULL;
    int pipe_fds[2];
    assert_int_equal(pipe2(pipe_fds, O_CLOEXEC), 0);
    pid_t child = fork();
    if (child == 0) {
      if (lod_store_open(fixture->path, &fixture->store, NULL) != LOD_OK)
        _exit(1);
      commit_until_killed(fixture, pipe_fds[1], acknowledged + 1);
    }
    close(pipe_fds[1]);
    unsigned number;
    if (round % 3 != 0) { /* else the start is hit as well */
      assert_int_equal(read(pipe_fds[0], &number, sizeof number), sizeof number);
      acknowledged = number;
      moved++;
    }
    nanosleep(&(struct timespec){.tv_nsec = 2000000 + rand() % 60000000}, NULL);
    kill(child, SIGKILL);
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFSIGNALED(status));
    for (; read(pipe_fds[0], &number, sizeof number) == sizeof number; moved++)
      acknowledged = number;
    close(pipe_fds[0]);
    fixture->bakes += 100000; /* folder names that the killed process did not use */
    reopen(fixture);
    unsigned newest = check_after_kill(fixture, acknowledged);
    acknowledged = newest > acknowledged ? newest : acknowledged;
    assert_true(count_objects(fixture) <= 5); /* no orphan is left after reopening */
  }
  print_message("  %d kills, %u commits acknowledged, the last of each model found after every kill\n", rounds, moved);
  assert_true(moved >= 20); /* the kills did hit commits, not only the start */
}

/* ---- a full disk ---- */

/* In a namespace of its own: a file system of 3 MB on fixture->root. Exits 77 where the kernel does not allow that. */
static void run_on_small_disk(struct fixture *fixture) {
  if ((unshare(CLONE_NEWNS) != 0 && unshare(CLONE_NEWUSER | CLONE_NEWNS) != 0) ||
      mount("none", "/", NULL, MS_REC | MS_PRIVATE, NULL) != 0 || mount("tmpfs", fixture->root, "tmpfs", 0, "size=4m") != 0)
    _exit(77);
  fixture->root_fd = open(fixture->root, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  struct lod_problem problem = {0};
  fixture->store = NULL;
  if (lod_store_open(fixture->path, &fixture->store, &problem) != LOD_OK)
    _exit(1);
  static char content[400000];
  enum lod_status status = LOD_OK;
  unsigned stored = 0;
  while (status == LOD_OK && stored < 100) {
    char id[16];
    snprintf(id, sizeof id, "m%u", stored);
    snprintf(content, sizeof content, "model %u", stored);
    const struct bake_level levels[] = {{content, sizeof content}};
    int fd = bake_folder(fixture);
    if (write_bake(fd, id, "r1", levels, 1, NULL) != 0)
      break; /* the worker would meet the full disk first */
    status = lod_store_commit_bake(fixture->store, id, fd, &problem);
    close(fd);
    stored += status == LOD_OK;
  }
  if (stored == 0 || stored == 100)
    _exit(2);
  /* A bake whose files are there already, on a disk without a free byte. */
  const struct bake_level tiny[] = {{"tiny", 0}};
  bool existed;
  if (lod_store_model_delete(fixture->store, "m0", NULL, &existed, &problem) != LOD_OK)
    _exit(3);
  int fd = bake_folder(fixture);
  static char page[65536];
  if (write_bake(fd, "tiny", "r1", tiny, 1, NULL) != 0)
    _exit(4);
  int filler = openat(fixture->root_fd, "filler", O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
  while (write(filler, page, sizeof page) > 0)
    ;
  close(filler);
  problem = (struct lod_problem){0};
  status = lod_store_commit_bake(fixture->store, "tiny", fd, &problem);
  if (status != LOD_OK && strcmp(problem.type, "disk-full") != 0) {
    fprintf(stderr, "%s: %s\n", problem.type, problem.detail);
    _exit(5);
  }
  struct lod_stored_model *model = lod_store_model_open(fixture->store, "tiny");
  if ((model != NULL) != (status == LOD_OK))
    _exit(6);
  lod_store_model_release(model);
  struct lod_problem full = {0};
  if (lod_store_ready(fixture->store, &full) || strcmp(full.type, "disk-full") != 0)
    _exit(7);
  /* Space comes back, and with it the store, without a restart. */
  unlinkat(fixture->root_fd, "filler", 0);
  if (status != LOD_OK) {
    int again = bake_folder(fixture);
    if (write_bake(again, "tiny", "r1", tiny, 1, NULL) != 0 || lod_store_commit_bake(fixture->store, "tiny", again, NULL) != LOD_OK)
      _exit(8);
  }
  reopen(fixture);
  model = lod_store_model_open(fixture->store, "tiny");
  struct lod_stored_model *last = lod_store_model_open(fixture->store, "m1");
  if (model == NULL || (stored > 1 && last == NULL))
    _exit(9);
  _exit(status == LOD_OK ? 10 : 0);
}

static void a_full_disk_is_a_clear_problem_and_heals_by_itself(void **state) {
  struct fixture *fixture = *state;
  pid_t child = fork();
  if (child == 0)
    run_on_small_disk(fixture);
  int status;
  assert_int_equal(waitpid(child, &status, 0), child);
  assert_true(WIFEXITED(status));
  if (WEXITSTATUS(status) == 77)
    skip();
  assert_int_equal(WEXITSTATUS(status), 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)
      TEST(what_was_committed_is_there_after_reopening),
      TEST(an_unchanged_id_leaves_the_manifest_byte_for_byte),
      TEST(another_id_in_the_manifest_is_replaced),
      TEST(two_models_share_an_object_until_both_are_gone),
      TEST(a_reader_keeps_what_it_holds_when_the_model_is_deleted),
      TEST(the_old_revision_serves_its_reader_beside_the_new_one),
      TEST(the_list_is_in_id_order_and_pages),
      TEST(ids_that_could_escape_are_refused),
      TEST(a_bake_that_lies_changes_nothing),
      TEST(files_that_the_manifest_does_not_name_stay_outside),
      TEST(a_delta_is_an_object_that_later_bakes_may_share),
      TEST(a_delta_is_known_by_the_level_that_it_starts_from),
      TEST(a_delta_that_does_not_lead_to_the_next_level_is_refused),
      TEST(a_bake_over_the_quota_is_refused_and_replacing_is_not),
      TEST(a_store_is_held_by_one_process),
      TEST(leftovers_are_swept_at_the_next_start),
      TEST(a_lost_object_is_a_problem_and_a_new_bake_mends_it),
      TEST(a_store_that_is_not_one_is_refused_with_a_reason),
      TEST(readers_never_meet_a_missing_object_while_revisions_change),
      TEST(a_store_of_version_1_is_taken_over_whole),
      TEST(a_kill_at_any_moment_loses_nothing_acknowledged),
      TEST(a_full_disk_is_a_clear_problem_and_heals_by_itself),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}

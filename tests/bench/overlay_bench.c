/* Overlays of nested levels: per model and step how many coarse triangles are mapped one to one, and how long that takes, beside finding
 * the neighbours of all triangles (adjacency.h), which comes first in it. Arguments: [-n N,N,...] [-c 1] PLY files; default: models/scans,
 * cad, iso, thin of the shared data, the ladder that re-tiling chooses. -c: checks every overlay in integers (slower). */
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/mesh/adjacency.h"
#include "core/mesh/overlay.h"
#include "core/retile/retile.h"
#include "tests/data/ply.h"

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(enum lod_status status) {
  if (status != LOD_OK) {
    fprintf(stderr, "overlay_bench: %s\n", lod_status_name(status));
    exit(1);
  }
}

static struct {
  double vertices, seconds, adjacency;
  uint64_t coarse, failed;
} total;
static bool checks;

/* CPU seconds to find who lies beside whom in both levels: what any algorithm on them does first. */
static double adjacency_seconds(const struct lod_mesh *coarse, const struct lod_mesh *fine) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_adjacency a, b;
  double begin = now();
  must(lod_adjacency_create(coarse, arena, &a));
  must(lod_adjacency_create(fine, arena, &b));
  double seconds = now() - begin;
  lod_arena_destroy(arena);
  return seconds;
}

static void run_step(const char *name, const struct lod_retile_level *level, const struct lod_retile_level *finer) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_overlay overlay;
  struct lod_overlay_facts facts;
  double begin = now();
  must(lod_overlay_create(&level->mesh, &finer->mesh, level->parents, NULL, arena, &overlay, NULL));
  double seconds = now() - begin;
  uint32_t states[5] = {0};
  for (uint32_t t = 0; t < level->mesh.triangle_count; t++)
    states[overlay.states[t]]++;
  printf("%-26s %8u %8u %8u %6.2f %6u %5u %5u %5u %8u %7.0f", name, level->mesh.vertex_count, finer->mesh.vertex_count, overlay.mapped,
         (double)overlay.triangle_count / fmax(1, finer->mesh.triangle_count), overlay.failed, states[LOD_OVERLAY_UNTRACED],
         states[LOD_OVERLAY_TORN], states[LOD_OVERLAY_FOLDED], overlay.lost, finer->mesh.vertex_count / seconds / 1000);
  if (checks) {
    must(lod_overlay_check(&overlay, &level->mesh, &finer->mesh, level->parents, arena, &facts));
    printf("  %s %s bent %u largest %u", facts.valid ? "valid" : "INVALID", facts.reason, facts.bent, facts.largest);
  }
  printf("\n");
  fflush(stdout);
  total.vertices += finer->mesh.vertex_count;
  total.seconds += seconds;
  total.adjacency += adjacency_seconds(&level->mesh, &finer->mesh);
  total.coarse += level->mesh.triangle_count;
  total.failed += overlay.failed;
  lod_arena_destroy(arena);
}

static void run_file(const char *path, const struct lod_retile_settings *settings) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh raw, mesh;
  struct lod_retile retile;
  const char *name = strrchr(path, '/') == NULL ? path : strrchr(path, '/') + 1;
  if (lod_ply_read(path, arena, &raw)) {
    must(lod_mesh_weld(&raw, arena, &mesh, NULL));
    must(lod_retile_create(&mesh, settings, NULL, arena, &retile, NULL));
    for (uint32_t k = 0; k + 1 < retile.level_count; k++)
      run_step(name, &retile.levels[k], &retile.levels[k + 1]);
  }
  lod_arena_destroy(arena);
}

static int compare_names(const void *a, const void *b) {
  return strcmp(*(char *const *)a, *(char *const *)b);
}

static void run_folder(const char *folder, const struct lod_retile_settings *settings) {
  DIR *dir = opendir(folder);
  char *names[1024];
  size_t count = 0;
  for (struct dirent *entry; dir != NULL && (entry = readdir(dir)) != NULL && count < 1024;)
    if (strstr(entry->d_name, ".ply") != NULL && strstr(entry->d_name, ".xz") == NULL)
      names[count++] = strdup(entry->d_name);
  if (dir != NULL)
    closedir(dir);
  qsort(names, count, sizeof *names, compare_names);
  for (size_t i = 0; i < count; i++) {
    char path[4300];
    snprintf(path, sizeof path, "%.4000s/%.255s", folder, names[i]);
    run_file(path, settings);
    free(names[i]);
  }
}

int main(int argc, char **argv) {
  struct lod_retile_settings settings = lod_retile_defaults();
  uint32_t counts[LOD_RETILE_MAX_LEVELS];
  int i = 1;
  for (; i + 1 < argc && argv[i][0] == '-'; i += 2) {
    if (argv[i][1] == 'c') {
      checks = true;
    } else if (argv[i][1] == 'n') {
      settings.vertices = counts;
      for (char *at = argv[i + 1]; *at != '\0' && settings.level_count < LOD_RETILE_MAX_LEVELS; at += *at == ',')
        counts[settings.level_count++] = (uint32_t)strtoul(at, &at, 10);
    }
  }
  printf("model                        coarse     fine   mapped frag/t failed untrc  torn  fold     lost kvert/s\n");
  for (int k = i; k < argc; k++)
    run_file(argv[k], &settings);
  const char *shared = lod_shared_folder(), *const folders[] = {"scans", "cad", "iso", "thin"};
  for (int k = 0; k < 4 && i >= argc && shared != NULL; k++) {
    char path[4300];
    snprintf(path, sizeof path, "%s/models/%s", shared, folders[k]);
    run_folder(path, &settings);
  }
  printf("all: %llu of %llu coarse triangles failed (%.4f %%); %.0f k vertices/s, %.1f times adjacency alone\n",
         (unsigned long long)total.failed, (unsigned long long)total.coarse, 100.0 * (double)total.failed / fmax(1, (double)total.coarse),
         total.vertices / fmax(total.seconds, 1e-9) / 1000, total.seconds / fmax(total.adjacency, 1e-9));
  return 0;
}

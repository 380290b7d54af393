/* What the files of bench-envelope share: one source mesh, one judge for whoever simplifies it. */
#ifndef LOD_TESTS_BENCH_ENVELOPE_BENCH_H
#define LOD_TESTS_BENCH_ENVELOPE_BENCH_H

#include "core/mesh/bvh.h"
#include "core/mesh/distance.h"
#include "core/mesh/topology.h"

struct bench {
  struct lod_arena *arena;
  const char *name;
  const struct lod_mesh *mesh;
  struct lod_bvh *bvh;
  struct lod_topology topology;
  uint64_t crossings; /* pairs of triangles that cross in the source */
  double diagonal;
};

/* What is known of one result. */
struct verdict {
  bool found; /* false: this method cannot, or is not there */
  uint32_t triangles;
  size_t draco;        /* bytes of the Draco buffer, positions alone */
  double lower, upper; /* certified, of what a client decodes; model units */
  double plain_upper;  /* certified, before quantisation */
  double rms;
  bool same_topology;
  struct lod_topology topology;
  uint64_t crossings;
  double seconds;   /* CPU, of one simplification: with bisection, of the one that was found */
  double megabytes; /* peak over what was held before */
};

void must(enum lod_status status);
double cpu_seconds(void);

/* Share of epsilon that quantisation gets, for everybody. */
#define BENCH_RESERVE 0.12

/* Certified distance to the source; hints may be NULL. */
struct lod_distance bench_measure(const struct bench *b, const struct lod_mesh *level, const uint32_t *nearby, bool rms);

/* Everything but seconds and memory. */
void bench_judge(const struct bench *b, const struct lod_mesh *level, const uint32_t *nearby, double epsilon, struct verdict *verdict);

/* Runs body in a child process, so that its peak memory can be told, and returns what it has made of the verdict. */
struct verdict bench_in_child(void (*body)(const struct bench *b, double epsilon, struct verdict *verdict), const struct bench *b,
                              double epsilon);

/* ---- methods: bodies for bench_in_child ---- */

void bench_collapse(const struct bench *b, double epsilon, struct verdict *verdict);      /* the family as it is baked */
void bench_cover(const struct bench *b, double epsilon, struct verdict *verdict);         /* Varshney's cover, certified alone */
void bench_cover_offsets(const struct bench *b, double epsilon, struct verdict *verdict); /* between offset surfaces */
void bench_meshopt(const struct bench *b, double epsilon, struct verdict *verdict);       /* bisected to the same certified error */
void bench_cgal(const struct bench *b, double epsilon, struct verdict *verdict);          /* likewise */

/* envelope_parts.c: percent reduction over the parts of an assembly, each by itself (the paper's table 2). False when the file is not
 * there. */
bool bench_parts(const char *path);

/* envelope_textured.c: levels with attributes. aims: a sentence for each percent, or NULL. False when the file is not there. */
bool bench_textured(const char *path, const double *percents, const char *const *aims, int count);

/* envelope_cgal.cc. Edge collapse down to at most `target` triangles. Returns how many there are, 0 when CGAL cannot take the mesh.
 * positions and triangles in, and room for as many out; *vertices: of the result. */
#ifdef __cplusplus
extern "C" {
#endif
bool bench_has_cgal(void);
uint32_t bench_cgal_collapse(const float (*positions)[3], uint32_t vertex_count, const uint32_t (*triangles)[3], uint32_t triangle_count,
                             uint32_t target, float (*out_positions)[3], uint32_t *out_vertices, uint32_t (*out_triangles)[3]);
#ifdef __cplusplus
}
#endif

#endif

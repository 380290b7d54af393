#include "clients/cli/facts.h"

#include <stdio.h>

#include "clients/cli/cli.h"

json_t *cli_topology_json(const struct lod_topology *t) {
  const struct {
    const char *name;
    json_int_t value;
  } counts[] = {
      {"vertices", t->vertices},
      {"triangles", t->triangles},
      {"edges", t->edges},
      {"components", t->components},
      {"boundary_edges", t->boundary_edges},
      {"boundary_loops", t->boundary_loops},
      {"non_manifold_edges", t->non_manifold_edges},
      {"non_manifold_vertices", t->non_manifold_vertices},
      {"misoriented_edges", t->misoriented_edges},
      {"degenerate_triangles", t->degenerate_triangles},
      {"zero_area_triangles", t->zero_area_triangles},
      {"duplicate_triangles", t->duplicate_triangles},
      {"euler", (json_int_t)t->euler},
  };
  json_t *json = json_object();
  for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++)
    json_object_set_new(json, counts[i].name, json_integer(counts[i].value));
  json_object_set_new(json, "genus", t->has_genus ? json_integer((json_int_t)t->genus) : json_null());
  json_object_set_new(json, "manifold", json_boolean(t->manifold));
  json_object_set_new(json, "closed", json_boolean(t->closed));
  json_object_set_new(json, "oriented", json_boolean(t->oriented));
  json_object_set_new(json, "orientable", json_boolean(t->orientable));
  return json;
}

void cli_print_topology(const struct lod_topology *t) {
  char a[32], b[32];
  printf("  %s vertices, %s triangles, %u component%s, ", cli_count(t->vertices, a), cli_count(t->triangles, b), t->components,
         t->components == 1 ? "" : "s");
  if (t->has_genus)
    printf("genus %lld, ", (long long)t->genus);
  if (t->closed)
    printf("closed");
  else
    printf("%u boundary loop%s", t->boundary_loops, t->boundary_loops == 1 ? "" : "s");
  printf("\n");
  const struct {
    uint32_t count;
    const char *what;
  } wrongs[] = {
      {t->non_manifold_edges, "non-manifold edges"},      {t->non_manifold_vertices, "non-manifold vertices"},
      {t->misoriented_edges, "misoriented edges"},        {t->degenerate_triangles, "degenerate triangles"},
      {t->zero_area_triangles, "triangles without area"}, {t->duplicate_triangles, "duplicate triangles"},
  };
  for (size_t i = 0; i < sizeof wrongs / sizeof wrongs[0]; i++)
    if (wrongs[i].count != 0)
      printf("  %s %s\n", cli_count(wrongs[i].count, a), wrongs[i].what);
}

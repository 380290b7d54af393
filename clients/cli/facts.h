/* A surface's facts, for people and as JSON. */
#ifndef LOD_CLIENTS_CLI_FACTS_H
#define LOD_CLIENTS_CLI_FACTS_H

#include <jansson.h>

#include "core/mesh/topology.h"

json_t *cli_topology_json(const struct lod_topology *topology);
void cli_print_topology(const struct lod_topology *topology);

#endif

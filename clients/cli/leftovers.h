/* Objects of an earlier bake into the same directory. */
#ifndef LOD_CLIENTS_CLI_LEFTOVERS_H
#define LOD_CLIENTS_CLI_LEFTOVERS_H

#include <jansson.h>

/* The names of all objects that directory_fd/manifest.json speaks of, as keys of a JSON object; empty when there is none. To be decref'd.
 */
json_t *cli_named_objects(int directory_fd);
/* Removes from objects/ what `before` names and the present manifest does not. What no manifest ever named is somebody else's and stays.
 * Returns how many files went. */
size_t cli_remove_leftovers(int directory_fd, const json_t *before);

#endif

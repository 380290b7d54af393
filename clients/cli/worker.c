/* lodestream worker: what the daemon spawns. */
#include "clients/cli/cli.h"

#include <fcntl.h>
#include <unistd.h>

#include "server/jobs/frame.h"
#include "server/worker/serve.h"

static int run(int argc, char **argv);

static const struct cli_option kOptions[] = {{0}};

const struct cli_command cli_worker = {
    .name = "worker",
    .usage = "(started by lodestreamd)",
    .sentence = "Run one job for lodestreamd; not for people.",
    .text = "Speaks length-checked frames over descriptor 3, reads the model from descriptor 4 and writes into the directory on\n"
            "descriptor 5. Jails itself before it reads a byte. LODESTREAM_JAIL=none switches the jail off, with a warning.",
    .options = kOptions,
    .run = run,
};

static int run(int argc, char **argv) {
  struct cli_arguments arguments = {.command = &cli_worker, .argc = argc, .argv = argv};
  const char *value;
  while (cli_next(&arguments, &value) != NULL)
    continue;
  if (arguments.operand_count != 0 || fcntl(LOD_WORKER_SOCKET_FD, F_GETFD) < 0 || fcntl(LOD_WORKER_OUTPUT_FD, F_GETFD) < 0)
    return cli_usage(&cli_worker, "it is started by lodestreamd, with a socket on descriptor %d", LOD_WORKER_SOCKET_FD);
  return lod_worker_serve();
}

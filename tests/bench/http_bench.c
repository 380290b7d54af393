/* Requests, bytes and the daemon's CPU seconds over loopback, by size of the answer and number of connections.
 *
 *   make bench-http [BENCH_ARGS="SECONDS"]     SECONDS: of each measurement, default 2
 *
 * The client is one thread that discards bodies in the kernel (MSG_TRUNC), so the daemon is what is measured; on loopback its CPU per
 * request is the firm number, the rate depends on what else the machine does. */
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <nettle/sha2.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/epoll.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "server/store/store.h"

static const size_t kSizes[] = {1 << 10, 16 << 10, 256 << 10, 4 << 20, 20 << 20};
enum { SIZES = sizeof kSizes / sizeof *kSizes };

static void must(bool good, const char *what) {
  if (good)
    return;
  fprintf(stderr, "http_bench: %s: %s\n", what, strerror(errno));
  exit(1);
}

/* A store with one model whose levels have the sizes above. */
static void make_store(const char *directory) {
  char path[300], levels[2048] = "", manifest[4096];
  snprintf(path, sizeof path, "%s/bake", directory);
  must(mkdir(path, 0700) == 0, path);
  snprintf(path, sizeof path, "%s/bake/objects", directory);
  must(mkdir(path, 0700) == 0, path);
  for (int i = 0; i < SIZES; i++) {
    uint8_t *bytes = malloc(kSizes[i]), digest[SHA256_DIGEST_SIZE];
    char name[LOD_SHA256_HEX + 1];
    struct sha256_ctx hash;
    must(bytes != NULL, "memory");
    uint32_t x = (uint32_t)i;
    for (size_t j = 0; j < kSizes[i]; j++)
      bytes[j] = (uint8_t)((x = x * 1664525 + 1013904223) >> 24);
    sha256_init(&hash);
    sha256_update(&hash, kSizes[i], bytes);
    sha256_digest(&hash, sizeof digest, digest);
    for (size_t j = 0; j < sizeof digest; j++)
      snprintf(name + 2 * j, 3, "%02x", digest[j]);
    snprintf(path, sizeof path, "%s/bake/objects/%s", directory, name);
    FILE *file = fopen(path, "w");
    must(file && fwrite(bytes, 1, kSizes[i], file) == kSizes[i] && fclose(file) == 0, path);
    free(bytes);
    snprintf(levels + strlen(levels), sizeof levels - strlen(levels),
             "%s{\"level\":%d,\"vertices\":1,\"triangles\":1,\"error\":%g,\"bytes\":%zu,\"object\":\"%s\",\"type\":\"model/gltf-binary\"}",
             i ? "," : "", i, 1.0 / (i + 1), kSizes[i], name);
  }
  snprintf(
      manifest, sizeof manifest,
      "{\"id\":\"m\",\"revision\":\"%064d\",\"source\":{\"format\":\"ply\",\"name\":\"m\",\"sha256\":\"%064d\",\"bytes\":1,\"vertices\":1,"
      "\"triangles\":1,\"components\":1,\"boundary_loops\":0,\"closed\":false,\"diagonal\":1,\"bounds\":{\"min\":[0,0,0],\"max\":[1,1,1]},"
      "\"sphere\":{\"center\":[0,0,0],\"radius\":1}},\"parts\":[{\"name\":\"p\",\"instances\":[[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]]}],"
      "\"families\":{\"cluster\":{\"nested\":false,\"levels\":[%s]}},\"bake\":{\"settings\":{},\"seconds\":1,\"warnings\":[]}}",
      1, 1, levels);
  snprintf(path, sizeof path, "%s/bake/manifest.json", directory);
  FILE *file = fopen(path, "w");
  must(file && fputs(manifest, file) >= 0 && fclose(file) == 0, path);

  struct lod_store *store;
  struct lod_problem problem = {0};
  snprintf(path, sizeof path, "%s/bake", directory);
  int fd = open(path, O_RDONLY | O_DIRECTORY);
  snprintf(path, sizeof path, "%s/store", directory);
  enum lod_status status = lod_store_open(path, &store, &problem);
  if (status == LOD_OK) {
    status = lod_store_commit_bake(store, "m", fd, &problem);
    lod_store_close(store);
  }
  close(fd);
  if (status != LOD_OK)
    fprintf(stderr, "http_bench: %s\n", problem.detail);
  must(status == LOD_OK, "store");
}

static pid_t start_daemon(const char *directory, uint16_t *port) {
  int ends[2];
  char store[300], line[200];
  snprintf(store, sizeof store, "%s/store", directory);
  must(pipe(ends) == 0, "pipe");
  pid_t pid = fork();
  if (pid == 0) {
    dup2(ends[1], STDOUT_FILENO);
    close(ends[0]);
    execl("build/release/lodestreamd", "lodestreamd", "--store", store, "--listen", "127.0.0.1:0", "--log-level", "error", (char *)NULL);
    _exit(127);
  }
  close(ends[1]);
  FILE *out = fdopen(ends[0], "r");
  const char *colon = out && fgets(line, sizeof line, out) ? strrchr(line, ':') : NULL;
  must(colon != NULL, "build/release/lodestreamd did not start");
  *port = (uint16_t)atoi(colon + 1);
  return pid;
}

static double cpu_seconds(pid_t pid) {
  char path[64], text[1024];
  unsigned long user = 0, system = 0;
  snprintf(path, sizeof path, "/proc/%d/stat", (int)pid);
  FILE *file = fopen(path, "r");
  size_t size = file ? fread(text, 1, sizeof text - 1, file) : 0;
  text[size] = 0;
  if (file)
    fclose(file);
  const char *fields = strrchr(text, ')');
  if (fields)
    sscanf(fields + 2, "%*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user, &system);
  return (double)(user + system) / (double)sysconf(_SC_CLK_TCK);
}

static double seconds_now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

struct client {
  int fd;
  size_t rest;       /* bytes of the body still to come; 0 = a header is awaited */
  char header[4096]; /* what came of it */
  size_t header_size;
};

static void ask(const struct client *client, const char *request, size_t size) {
  must(send(client->fd, request, size, MSG_NOSIGNAL) == (ssize_t)size, "send");
}

/* Reads what is there; true when an answer became whole. */
static bool take(struct client *client, uint64_t *bytes) {
  for (;;) {
    if (client->rest) {
      ssize_t count = recv(client->fd, NULL, client->rest, MSG_TRUNC | MSG_DONTWAIT);
      if (count < 0 && errno == EAGAIN)
        return false;
      must(count > 0, "recv");
      client->rest -= (size_t)count;
      *bytes += (uint64_t)count;
      if (!client->rest)
        return true;
      continue;
    }
    ssize_t count = recv(client->fd, client->header + client->header_size, sizeof client->header - 1 - client->header_size, MSG_DONTWAIT);
    if (count < 0 && errno == EAGAIN)
      return false;
    must(count > 0, "recv");
    client->header_size += (size_t)count;
    client->header[client->header_size] = 0;
    const char *end = strstr(client->header, "\r\n\r\n");
    if (!end)
      continue;
    const char *length = strcasestr(client->header, "Content-Length:");
    must(length && strncmp(client->header, "HTTP/1.1 200", 12) == 0, "answer");
    size_t there = client->header_size - (size_t)(end + 4 - client->header);
    client->rest = strtoul(length + 15, NULL, 10) - there;
    *bytes += there;
    client->header_size = 0;
    if (!client->rest)
      return true;
  }
}

static void measure(pid_t daemon, uint16_t port, int level, int connections, double seconds) {
  char request[200];
  int request_size =
      snprintf(request, sizeof request, "GET /v1/models/m/level?error=%g HTTP/1.1\r\nHost: x\r\n\r\n", 1.0 / (level + 1) * 1.0001);
  struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(port), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  struct client *clients = calloc((size_t)connections, sizeof *clients);
  int epoll = epoll_create1(0);
  must(clients && epoll >= 0, "epoll");
  for (int i = 0; i < connections; i++) {
    clients[i].fd = socket(AF_INET, SOCK_STREAM, 0);
    must(connect(clients[i].fd, (struct sockaddr *)&address, sizeof address) == 0, "connect");
    struct epoll_event event = {.events = EPOLLIN, .data.ptr = &clients[i]};
    must(epoll_ctl(epoll, EPOLL_CTL_ADD, clients[i].fd, &event) == 0, "epoll");
    ask(&clients[i], request, (size_t)request_size);
  }
  uint64_t answers = 0, bytes = 0;
  double began = seconds_now(), cpu = cpu_seconds(daemon), now;
  while ((now = seconds_now()) - began < seconds) {
    struct epoll_event events[256];
    int count = epoll_wait(epoll, events, 256, 1000);
    for (int i = 0; i < count; i++)
      if (take(events[i].data.ptr, &bytes)) {
        answers++;
        ask(events[i].data.ptr, request, (size_t)request_size);
      }
  }
  cpu = cpu_seconds(daemon) - cpu;
  printf("%9zu %6d %10.0f %10.0f %12.1f\n", kSizes[level], connections, (double)answers / (now - began),
         (double)bytes / (now - began) * 1e-6, answers ? cpu / (double)answers * 1e6 : 0.0);
  for (int i = 0; i < connections; i++)
    close(clients[i].fd);
  close(epoll);
  free(clients);
}

int main(int argc, char **argv) {
  double seconds = argc > 1 ? atof(argv[1]) : 2;
  char directory[] = "/tmp/lodestream-bench-XXXXXX", command[100];
  must(mkdtemp(directory) != NULL, "mkdtemp");
  make_store(directory);
  uint16_t port;
  pid_t daemon = start_daemon(directory, &port);
  static const int kConnections[] = {1, 6, 32, 128, 256};
  printf("    bytes  conns        req/s       MB/s   CPU us/req (daemon)\n");
  for (int i = 0; i < SIZES; i++)
    for (size_t j = 0; j < sizeof kConnections / sizeof *kConnections; j++)
      measure(daemon, port, i, kConnections[j], seconds);
  kill(daemon, SIGTERM);
  waitpid(daemon, NULL, 0);
  snprintf(command, sizeof command, "rm -rf %s", directory);
  return system(command) == 0 ? 0 : 1;
}

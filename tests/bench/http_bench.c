/* The daemon beside nginx over loopback: requests and bytes a second, CPU a request, latencies.
 *
 *   make bench-http [BENCH_ARGS="[SECONDS [ROUNDS [PART [CELL]]]]"]
 *        defaults 0.5, 5, all; PART: grid, kinds, mixed, idle; CELL: only those whose name and connections, as in "16 KB 32", begin so
 *
 * Both serve the same bytes (nginx from files: 2 workers, sendfile, tcp_nopush, open_file_cache, reuseport), and take turns: A B, B A, ...
 * Every ratio is taken within a round; what is printed is the median. The client copies all bodies and is one thread. On loopback TCP work
 * moves between the two ends, so the CPU of server and client together is printed too; requests a second depend on what else the machine
 * does. Everything stays on 127.0.0.1. */
#include <arpa/inet.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <nettle/sha2.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "server/store/store.h"
#include "tests/bench/load/load.h"

static const size_t kSizes[] = {1 << 10, 16 << 10, 256 << 10, 4 << 20, 20 << 20};
enum { SIZES = sizeof kSizes / sizeof *kSizes };

static void must(bool good, const char *what) {
  if (good)
    return;
  fprintf(stderr, "http_bench: %s: %s\n", what, strerror(errno));
  exit(1);
}

static char names[SIZES][LOD_SHA256_HEX + 1];

/* DIRECTORY/www/NAME: what nginx serves. */
static void write_file(const char *directory, const char *name, const void *bytes, size_t size) {
  char path[400];
  snprintf(path, sizeof path, "%s/www/%s", directory, name);
  FILE *file = fopen(path, "w");
  must(file && fwrite(bytes, 1, size, file) == size && fclose(file) == 0, path);
}

/* A store with one model whose levels have the sizes above. */
static void make_store(const char *directory) {
  char path[300], levels[2048] = "", manifest[4096];
  snprintf(path, sizeof path, "%s/www", directory);
  must(mkdir(path, 0755) == 0, path);
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
    strcpy(names[i], name);
    snprintf(path, sizeof path, "%s/bake/objects/%s", directory, name);
    FILE *file = fopen(path, "w");
    must(file && fwrite(bytes, 1, kSizes[i], file) == kSizes[i] && fclose(file) == 0, path);
    write_file(directory, name, bytes, kSizes[i]);
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
  write_file(directory, "manifest", manifest, strlen(manifest));
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

/* ---- servers ---- */

enum { DAEMON, NGINX, SERVERS };
static const char *const kServers[] = {"lodestream", "nginx"};

struct server {
  pid_t pid;
  uint16_t port, tls_port;
  pid_t tls_pid; /* the daemon needs a second process for it, nginx does not */
};

static void make_certificate(const char *directory) {
  char command[1000];
  snprintf(command, sizeof command,
           "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=localhost -keyout %s/key.pem -out "
           "%s/cert.pem >/dev/null 2>&1",
           directory, directory);
  must(system(command) == 0, "openssl");
}

static pid_t start_daemon(const char *directory, const char *store, bool tls, uint16_t *port) {
  int ends[2];
  char line[200], path[300], certificate[300], key[300];
  snprintf(path, sizeof path, "%s/%s", directory, store);
  snprintf(certificate, sizeof certificate, "%s/cert.pem", directory);
  snprintf(key, sizeof key, "%s/key.pem", directory);
  must(pipe(ends) == 0, "pipe");
  pid_t pid = fork();
  if (pid == 0) {
    dup2(ends[1], STDOUT_FILENO);
    close(ends[0]);
    execl("build/release/lodestreamd", "lodestreamd", "--store", path, "--listen", "127.0.0.1:0", "--log-level", "error", "--connections",
          "20000", "--address-connections", "0", "--idle-seconds", "300", tls ? "--tls-cert" : (char *)NULL, certificate, "--tls-key", key,
          (char *)NULL);
    _exit(127);
  }
  close(ends[1]);
  FILE *out = fdopen(ends[0], "r");
  const char *colon = out && fgets(line, sizeof line, out) ? strrchr(line, ':') : NULL;
  must(colon != NULL, "build/release/lodestreamd did not start");
  *port = (uint16_t)atoi(colon + 1);
  return pid;
}

static uint16_t free_port(void) {
  struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  socklen_t size = sizeof address;
  int fd = socket(AF_INET, SOCK_STREAM, 0);
  must(bind(fd, (struct sockaddr *)&address, size) == 0 && getsockname(fd, (struct sockaddr *)&address, &size) == 0, "port");
  close(fd);
  return ntohs(address.sin_port);
}

static void start_nginx(const char *directory, struct server *server) {
  char path[300], text[4096];
  server->port = free_port();
  server->tls_port = free_port();
  snprintf(path, sizeof path, "%s/nginx.conf", directory);
  int size = snprintf(
      text, sizeof text,
      "daemon off; master_process on; worker_processes 2; worker_rlimit_nofile 100000; pid %s/nginx.pid; error_log %s/nginx.log;\n"
      "events { worker_connections 20000; use epoll; }\n"
      "http { access_log off; sendfile on; tcp_nopush on; tcp_nodelay on; keepalive_requests 1000000000; keepalive_timeout 300;\n"
      "  open_file_cache max=1000 inactive=600s; open_file_cache_valid 600s; default_type application/octet-stream;\n"
      "  client_body_temp_path %s/t1; proxy_temp_path %s/t2; fastcgi_temp_path %s/t3; uwsgi_temp_path %s/t4; scgi_temp_path %s/t5;\n"
      "  server { listen 127.0.0.1:%u reuseport backlog=4096; listen 127.0.0.1:%u ssl reuseport backlog=4096;\n"
      "    ssl_certificate %s/cert.pem; ssl_certificate_key %s/key.pem; ssl_protocols TLSv1.3; root %s/www;\n"
      "    add_header Access-Control-Allow-Origin *; add_header Cross-Origin-Resource-Policy cross-origin;\n"
      "    add_header X-Content-Type-Options nosniff; add_header Cache-Control 'public, max-age=31536000, immutable'; } }\n",
      directory, directory, directory, directory, directory, directory, directory, server->port, server->tls_port, directory, directory,
      directory);
  FILE *file = fopen(path, "w");
  must(file && fwrite(text, 1, (size_t)size, file) == (size_t)size && fclose(file) == 0, path);
  server->pid = fork();
  if (server->pid == 0) {
    char user[] = "user root;";
    execlp("nginx", "nginx", "-p", directory, "-c", path, "-g", geteuid() == 0 ? user : "", (char *)NULL);
    execl("/usr/sbin/nginx", "nginx", "-p", directory, "-c", path, "-g", geteuid() == 0 ? user : "", (char *)NULL);
    _exit(127);
  }
}

/* ---- what they cost ---- */

/* Nanoseconds on a processor of every thread of a process and of its children (nginx's workers). */
static double cpu_seconds(pid_t pid) {
  char path[300], text[256];
  double sum = 0;
  snprintf(path, sizeof path, "/proc/%d/task", (int)pid);
  DIR *folder = opendir(path);
  for (const struct dirent *task; folder && (task = readdir(folder)) != NULL;) {
    if (task->d_name[0] == '.')
      continue;
    snprintf(path, sizeof path, "/proc/%d/task/%.20s/schedstat", (int)pid, task->d_name);
    FILE *file = fopen(path, "r");
    if (file && fgets(text, sizeof text, file))
      sum += 1e-9 * strtod(text, NULL);
    if (file)
      fclose(file);
    snprintf(path, sizeof path, "/proc/%d/task/%.20s/children", (int)pid, task->d_name);
    file = fopen(path, "r");
    for (int child; file && fscanf(file, "%d", &child) == 1;)
      sum += cpu_seconds(child);
    if (file)
      fclose(file);
  }
  if (folder)
    closedir(folder);
  return sum;
}

static double memory_mb(pid_t pid) {
  char path[64], line[256];
  double kb = 0;
  snprintf(path, sizeof path, "/proc/%d/status", (int)pid);
  FILE *file = fopen(path, "r");
  while (file && fgets(line, sizeof line, file))
    if (strncmp(line, "VmRSS:", 6) == 0)
      kb = strtod(line + 6, NULL);
  if (file)
    fclose(file);
  return kb / 1024;
}

/* ---- one cell ---- */

struct cell {
  const char *name;
  const char *paths[SERVERS];   /* after the leading slash */
  const char *headers[SERVERS]; /* further ones, each ended by \r\n; NULL = none */
  unsigned status;
  int connections;
  bool tls, reconnect;
  int bulk; /* connections that pull the largest object meanwhile */
};

struct measured {
  double rate, megabytes, server_us, total_us, p50, p99, bulk_megabytes;
  uint64_t errors;
};

struct meter {
  pid_t pid;
  double cpu;
};
static void start_meter(void *context) {
  struct meter *meter = context;
  meter->cpu = cpu_seconds(meter->pid);
}

static struct measured measure(const struct server *server, int which, const struct cell *cell, double seconds) {
  char request[700], bulk[300];
  static struct load_group groups[2];
  snprintf(request, sizeof request, "GET /%s HTTP/1.1\r\nHost: localhost\r\n%s%s\r\n", cell->paths[which],
           cell->headers[which] ? cell->headers[which] : "", cell->reconnect ? "Connection: close\r\n" : "");
  snprintf(bulk, sizeof bulk, "GET /%s%s HTTP/1.1\r\nHost: localhost\r\n\r\n", which == DAEMON ? "v1/objects/" : "", names[SIZES - 1]);
  groups[0] = (struct load_group){.port = cell->tls ? server->tls_port : server->port,
                                  .tls = cell->tls,
                                  .reconnect = cell->reconnect,
                                  .request = request,
                                  .status = cell->status,
                                  .connections = cell->connections};
  groups[1] = (struct load_group){.port = server->port, .request = bulk, .status = 200, .connections = cell->bulk};
  pid_t pid = cell->tls && server->tls_pid ? server->tls_pid : server->pid;
  struct meter meter = {.pid = pid};
  double took = seconds;
  double client = load_run(groups, cell->bulk ? 2 : 1, &took, start_meter, &meter);
  double cpu = cpu_seconds(pid) - meter.cpu;
  double answers = groups[0].answers ? (double)groups[0].answers : 1e-9;
  return (struct measured){.rate = (double)groups[0].answers / took,
                           .megabytes = (double)groups[0].bytes / took * 1e-6,
                           .server_us = cpu / answers * 1e6,
                           .total_us = (cpu + client) / answers * 1e6,
                           .p50 = load_quantile(&groups[0], 0.5) * 1e6,
                           .p99 = load_quantile(&groups[0], 0.99) * 1e6,
                           .bulk_megabytes = (double)groups[1].bytes / took * 1e-6,
                           .errors = groups[0].errors + groups[1].errors};
}

static int by_value(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}
static double median(double *values, int count) {
  qsort(values, (size_t)count, sizeof *values, by_value);
  return count % 2 ? values[count / 2] : (values[count / 2 - 1] + values[count / 2]) / 2;
}

enum { ROUNDS_MAX = 25, FIGURES = 7 };

static const char *only = ""; /* cells that begin so */

static void run_cell(struct server *servers, const struct cell *cell, double seconds, int rounds) {
  char label[80];
  snprintf(label, sizeof label, "%s %d", cell->name, cell->connections);
  if (strncmp(label, only, strlen(only)) != 0)
    return;
  double figures[SERVERS][FIGURES][ROUNDS_MAX], ratios[FIGURES][ROUNDS_MAX];
  uint64_t errors[SERVERS] = {0};
  for (int round = 0; round < rounds; round++) {
    struct measured results[SERVERS];
    for (int i = 0; i < SERVERS; i++) {
      int which = round % 2 ? SERVERS - 1 - i : i;
      results[which] = measure(&servers[which], which, cell, seconds);
      errors[which] += results[which].errors;
    }
    for (int which = 0; which < SERVERS; which++) {
      const struct measured *m = &results[which];
      const double list[FIGURES] = {m->rate, m->megabytes, m->server_us, m->total_us, m->p50, m->p99, m->bulk_megabytes};
      for (int i = 0; i < FIGURES; i++)
        figures[which][i][round] = list[i];
    }
    for (int i = 0; i < FIGURES; i++)
      ratios[i][round] = figures[NGINX][i][round] > 0 ? figures[DAEMON][i][round] / figures[NGINX][i][round] : 0;
  }
  double m[SERVERS][FIGURES], r[FIGURES];
  for (int i = 0; i < FIGURES; i++) {
    r[i] = median(ratios[i], rounds);
    for (int which = 0; which < SERVERS; which++)
      m[which][i] = median(figures[which][i], rounds);
  }
  printf("%-22s %5d %7.0f/%-7.0f %5.0f/%-5.0f %6.2f %7.1f/%-7.1f %5.2f %5.2f %7.0f/%-7.0f %7.0f/%-7.0f %5.2f", cell->name,
         cell->connections, m[0][0], m[1][0], m[0][1], m[1][1], r[0], m[0][2], m[1][2], r[2], r[3], m[0][4], m[1][4], m[0][5], m[1][5],
         r[5]);
  if (cell->bulk)
    printf("  bulk %.0f/%.0f MB/s (%.2f)", m[0][6], m[1][6], r[6]);
  if (errors[0] || errors[1])
    printf("  ERRORS %llu/%llu", (unsigned long long)errors[0], (unsigned long long)errors[1]);
  printf("\n");
  fflush(stdout);
}

static void print_head(void) {
  printf(
      "lodestream/nginx            req/s            MB/s     ratio  server us/req   ratio total     p50 us          p99 us      ratio\n");
}

/* ---- the parts ---- */

static void run_grid(struct server *servers, double seconds, int rounds) {
  static const char *const kNames[SIZES] = {"1 KB", "16 KB", "256 KB", "4 MB", "20 MB"};
  static const int kConnections[] = {1, 32, 128, 256, 1000};
  for (int size = 0; size < SIZES; size++)
    for (size_t k = 0; k < sizeof kConnections / sizeof *kConnections; k++) {
      char path[100];
      snprintf(path, sizeof path, "v1/objects/%.64s", names[size]);
      /* A thousand answers of 20 MB want more than half a second. */
      double longer = (double)kSizes[size] * kConnections[k] / 1e9;
      run_cell(servers, &(struct cell){.name = kNames[size], .paths = {path, names[size]}, .status = 200, .connections = kConnections[k]},
               longer > seconds ? longer < 6 ? longer : 6 : seconds, rounds);
    }
}

static void run_kinds(struct server *servers, const char *directory, double seconds, int rounds) {
  static const char kRange[] = "Range: bytes=1000000-1065535\r\n";
  char object[SIZES][100], match[SERVERS][200], path[400];
  struct stat facts;
  for (int i = 0; i < SIZES; i++)
    snprintf(object[i], sizeof object[i], "v1/objects/%.64s", names[i]);
  snprintf(path, sizeof path, "%s/www/%s", directory, names[1]);
  must(stat(path, &facts) == 0, path);
  snprintf(match[DAEMON], sizeof match[DAEMON], "If-None-Match: \"%s\"\r\n", names[1]);
  snprintf(match[NGINX], sizeof match[NGINX], "If-None-Match: \"%lx-%lx\"\r\n", (long)facts.st_mtime, (long)facts.st_size);
  const struct cell cells[] = {
      {"304", {object[1], names[1]}, {match[DAEMON], match[NGINX]}, 304, 32, false, false, 0},
      {"range 64 KB of 4 MB", {object[3], names[3]}, {kRange, kRange}, 206, 32, false, false, 0},
      {"JSON manifest", {"v1/models/m", "manifest"}, {NULL}, 200, 32, false, false, 0},
      {"level, 1 KB", {"v1/models/m/level?error=1.1", names[0]}, {NULL}, 200, 32, false, false, 0},
      {"level in view, 1 KB", {"v1/models/m/level?px=5000&distance=1", names[0]}, {NULL}, 200, 32, false, false, 0},
      {"new connection, 1 KB", {object[0], names[0]}, {NULL}, 200, 32, false, true, 0},
      {"TLS 1 KB", {object[0], names[0]}, {NULL}, 200, 32, true, false, 0},
      {"TLS 256 KB", {object[2], names[2]}, {NULL}, 200, 32, true, false, 0},
      {"TLS 4 MB", {object[3], names[3]}, {NULL}, 200, 32, true, false, 0},
  };
  for (size_t i = 0; i < sizeof cells / sizeof *cells; i++)
    run_cell(servers, &cells[i], seconds, rounds);
}

static void run_mixed(struct server *servers, double seconds, int rounds) {
  char object[100];
  snprintf(object, sizeof object, "v1/objects/%s", names[0]);
  run_cell(servers, &(struct cell){"1 KB beside 12 x 20 MB", {object, names[0]}, {NULL}, 200, 4, false, false, 12}, 4 * seconds, rounds);
}

/* 10 000 connections that asked once and stay, and 1 000 that go on asking ten times a second, for a minute. */
static void run_idle(struct server *servers) {
  for (int which = 0; which < SERVERS; which++) {
    char request[200];
    static struct load_group group;
    snprintf(request, sizeof request, "GET /%s%s HTTP/1.1\r\nHost: localhost\r\n\r\n", which == DAEMON ? "v1/objects/" : "", names[0]);
    group = (struct load_group){
        .port = servers[which].port, .request = request, .status = 200, .connections = 1000, .silent = 10000, .pause_seconds = 0.1};
    struct meter meter = {.pid = servers[which].pid};
    double before = memory_mb(servers[which].pid), took = 60;
    load_run(&group, 1, &took, start_meter, &meter);
    double cpu = cpu_seconds(servers[which].pid) - meter.cpu;
    printf(
        "%-10s 10 000 idle + 1 000 asking every 0.1 s for %.0f s: %llu answers, %llu errors, p50 %.0f us, p99 %.0f us, %.1f us CPU each, "
        "resident %.0f -> %.0f MB\n",
        kServers[which], took, (unsigned long long)group.answers, (unsigned long long)group.errors, load_quantile(&group, 0.5) * 1e6,
        load_quantile(&group, 0.99) * 1e6, cpu / (double)(group.answers ? group.answers : 1) * 1e6, before, memory_mb(servers[which].pid));
    fflush(stdout);
  }
}

static void stop(pid_t pid) {
  if (pid <= 0)
    return;
  kill(pid, SIGTERM);
  waitpid(pid, NULL, 0);
}

int main(int argc, char **argv) {
  double seconds = argc > 1 ? atof(argv[1]) : 0.5;
  int rounds = argc > 2 ? atoi(argv[2]) : 5;
  const char *part = argc > 3 ? argv[3] : "all";
  only = argc > 4 ? argv[4] : "";
  rounds = rounds < 1 ? 1 : rounds > ROUNDS_MAX ? ROUNDS_MAX : rounds;
  char directory[] = "/tmp/lodestream-bench-XXXXXX", command[300];
  must(mkdtemp(directory) != NULL && chmod(directory, 0755) == 0, "mkdtemp");
  make_store(directory);
  make_certificate(directory);
  snprintf(command, sizeof command, "cp -r %s/store %s/store-tls", directory, directory);
  must(system(command) == 0, "cp");
  struct server servers[SERVERS] = {{0}};
  servers[DAEMON].pid = start_daemon(directory, "store", false, &servers[DAEMON].port);
  servers[DAEMON].tls_pid = start_daemon(directory, "store-tls", true, &servers[DAEMON].tls_port);
  start_nginx(directory, &servers[NGINX]);
  usleep(500000);
  must(waitpid(servers[NGINX].pid, NULL, WNOHANG) == 0, "nginx did not start; is it installed?");
  bool all = strcmp(part, "all") == 0;
  if (strcmp(part, "idle") != 0)
    print_head();
  if (all || strcmp(part, "grid") == 0)
    run_grid(servers, seconds, rounds);
  if (all || strcmp(part, "kinds") == 0)
    run_kinds(servers, directory, seconds, rounds);
  if (all || strcmp(part, "mixed") == 0)
    run_mixed(servers, seconds, rounds);
  if (all || strcmp(part, "idle") == 0)
    run_idle(servers);
  stop(servers[DAEMON].pid);
  stop(servers[DAEMON].tls_pid);
  stop(servers[NGINX].pid);
  snprintf(command, sizeof command, "rm -rf %s", directory);
  return system(command) == 0 ? 0 : 1;
}

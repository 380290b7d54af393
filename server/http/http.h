/* The HTTP server: event loops over libmicrohttpd, which nothing else in the program includes.
 *
 * One loop a processor, each a thread with an epoll of its own, an MHD daemon that it drives (MHD_run) and a listener that shares the port
 * by SO_REUSEPORT. README.md in this folder says which traps of libmicrohttpd 0.9.75 this shape avoids. */
#ifndef LOD_SERVER_HTTP_HTTP_H
#define LOD_SERVER_HTTP_HTTP_H

#include "server/http/routes.h"

struct lod_http;

/* Binds and starts. service: not owned; outlives the server. inherited: a listening socket to use (taken), -1: bind to the setting. */
LOD_WARN_UNUSED enum lod_status lod_http_create(struct lod_service *service, int inherited, struct lod_http **http,
                                                struct lod_problem *problem);
/* The service's settings were replaced: forgets prepared answers, whose headers may differ now. */
void lod_http_settings_changed(struct lod_http *http);
/* The longest that any loop has not turned; each does at least once a second unless it hangs. */
double lod_http_idle_seconds(const struct lod_http *http);
/* "http://127.0.0.1:8080" */
const char *lod_http_url(const struct lod_http *http);
/* Wakes the streams of job events, and lets go of what a new revision replaced; any thread. */
void lod_http_job_changed(struct lod_http *http);
/* Takes no more connections, lets answers in progress finish for so long, cuts what is left, ends the loops and frees all. NULL is allowed.
 */
void lod_http_destroy(struct lod_http *http, double drain_seconds);

#endif

/* Names, defaults and sources of the options, from one list. */
#include "core.h"

#define OPTION(name, value, source) #name,
static const char *const names[] = {
#include "options.def"
};
#undef OPTION
#define OPTION(name, value, source) source,
static const char *const sources[] = {
#include "options.def"
};
#undef OPTION

#define COUNT ((int32_t)(sizeof names / sizeof *names))

int32_t twx_options_count(void) { return COUNT; }

const char *twx_option_name(int32_t i) { return i >= 0 && i < COUNT ? names[i] : NULL; }

const char *twx_option_source(int32_t i) { return i >= 0 && i < COUNT ? sources[i] : NULL; }

void twx_defaults(twx_options *options) {
#define OPTION(name, value, source) options->name = value;
#include "options.def"
#undef OPTION
}

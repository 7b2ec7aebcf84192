/* The part of string.h that is used; defined in startup.c. */
#ifndef STRING_H
#define STRING_H

#include <stddef.h>

void *memset(void *to, int value, size_t n);
void *memcpy(void *to, const void *from, size_t n);

#endif /* STRING_H */

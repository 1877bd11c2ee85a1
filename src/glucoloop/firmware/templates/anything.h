extern void anything(void *to, unsigned long size);
/*@ assigns ((char *)to)[0 .. size - 1] \from \nothing; */
void anything(void *to, unsigned long size);

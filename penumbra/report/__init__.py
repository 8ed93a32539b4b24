"""One offline HTML page made of the pipeline's files. It computes no statistics."""

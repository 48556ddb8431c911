"""Models behind three protocols: segmenter, encoder, text segmenter; one file per backend."""

//! Bytes to nouns and back: the PLY family, .splat, meshes and images

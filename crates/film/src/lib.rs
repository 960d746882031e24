//! Frames to PNG, MP4 and PLY sequences: camera paths, false colour, legends

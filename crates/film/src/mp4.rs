//! Films: H.264 in MP4 with the index first, made without any external program.
//!
//! What is chosen so that it plays everywhere: constrained baseline profile, 4:2:0, 8 bits, one key frame every two seconds,
//! BT.709 matrix and limited range, said so in the stream. Players that ignore what the stream says guess BT.601 below 720
//! lines; none of the common ones (browsers, QuickTime, VLC, mpv, ffmpeg) does, they guess only for streams that say nothing.

use std::path::{Path, PathBuf};

use megas_formats::{AtomicFile, FormatError};
use megas_model::Image;
use muxide::api::{Muxer, MuxerBuilder, VideoCodec};
use openh264::{
    OpenH264API, Timestamp,
    encoder::{
        BitRate, Complexity, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange, RateControlMode, UsageType, VuiConfig,
    },
    formats::YUVSource,
};

use crate::{
    error::{FilmError, Result, mismatch},
    yuv::Planes,
};

/// Seconds between key frames: how precisely a player can jump.
const KEY_SECONDS: f64 = 2.0;
/// Constant quantiser: below 18 nobody sees a difference, above 24 smooth gradients begin to show blocks.
const QUANTISER: u8 = 20;
/// How much coarser the quantiser gets when a picture is too rich for the encoder, and how often that may happen.
const COARSER: u8 = 6;
const RETRIES: u8 = 4;
/// Bits per pixel and frame announced to the encoder, which derives the level from it.
const BITS_PER_PIXEL: f64 = 0.25;

/// What a finished film is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilmStats {
    /// Number of frames.
    pub frames: u64,
    /// Length \[s\].
    pub seconds: f64,
}

/// Writes one film. The file appears under its name when [`Mp4Writer::finish`] succeeds; the compressed frames are kept in
/// memory until then, because the index that players want first is known last.
pub struct Mp4Writer {
    path: PathBuf,
    width: u32,
    height: u32,
    fps: f64,
    frames: u64,
    planes: Planes,
    encoder: Encoder,
    packet: Vec<u8>,
    muxer: Muxer<AtomicFile>,
}

impl Mp4Writer {
    /// Starts a film of `width` × `height` pixels (16–3840 × 16–2160 or upright) at `fps` frames per second (1–240). Odd sizes
    /// are padded to even ones by repeating the last column or row.
    pub fn create(path: impl AsRef<Path>, width: u32, height: u32, fps: f64, overwrite: bool) -> Result<Self> {
        let (long, short) = (width.max(height), width.min(height));
        if short < 16 || long > 3840 || short > 2160 {
            return Err(mismatch(format!("a film of {width}x{height} pixels"), "from 16x16 to 3840x2160 pixels"));
        }
        if !(1.0..=240.0).contains(&fps) {
            return Err(mismatch(format!("{fps} frames per second"), "1 to 240"));
        }
        let path = path.as_ref().to_path_buf();
        let file = AtomicFile::create(&path, overwrite)?;
        let (w, h) = (width.next_multiple_of(2), height.next_multiple_of(2));
        let encoder = encoder(w, h, fps, QUANTISER).map_err(|e| video(&path, e))?;
        let muxer = MuxerBuilder::new(file).video(VideoCodec::H264, w, h, fps).with_fast_start(true).build();
        let muxer = muxer.map_err(|e| video(&path, e))?;
        Ok(Self { path, width, height, fps, frames: 0, planes: Planes::new(width, height), encoder, packet: Vec::new(), muxer })
    }

    /// Appends a frame: 1 (grey), 3 (RGB) or 4 (RGBA, put on black) channels of display-referred sRGB in [0, 1].
    pub fn push(&mut self, image: &Image) -> Result<()> {
        if (image.width, image.height) != (self.width, self.height) || !matches!(image.channels, 1 | 3 | 4) {
            let found = format!("a frame of {}x{} pixels and {} channels", image.width, image.height, image.channels);
            return Err(mismatch(found, format!("{}x{} pixels and 1, 3 or 4 channels like the film", self.width, self.height)));
        }
        self.planes.fill(image);
        let time = self.frames as f64 / self.fps;
        let stamp = Timestamp::from_millis((1000.0 * time) as u64);
        let mut failures = 0;
        let key = loop {
            match self.encoder.encode_at(&self.planes, stamp) {
                Ok(coded) => {
                    self.packet.clear();
                    coded.write_vec(&mut self.packet);
                    break matches!(coded.frame_type(), FrameType::IDR | FrameType::I);
                }
                Err(e) if failures == RETRIES => return Err(video(&self.path, e)),
                Err(_) => {
                    // A picture like white noise does not fit into the encoder's buffer at this quality, and the failure leaves
                    // the encoder unusable: go on from a key frame with a coarser one. The parameter sets stay the same.
                    failures += 1;
                    let quantiser = QUANTISER + failures * COARSER;
                    let (w, h) = self.planes.dimensions();
                    self.encoder = encoder(w as u32, h as u32, self.fps, quantiser).map_err(|e| video(&self.path, e))?;
                }
            }
        };
        self.muxer.write_video(time, &self.packet, key).map_err(|e| video(&self.path, e))?;
        self.frames += 1;
        Ok(())
    }

    /// Writes the index, and the film appears under its name. A film without frames is an error.
    pub fn finish(self) -> Result<FilmStats> {
        let Self { path, fps, frames, mut muxer, .. } = self;
        if frames == 0 {
            return Err(mismatch("a film without frames", "at least one"));
        }
        muxer.finish_in_place().map_err(|e| match e {
            muxide::api::MuxerError::Io(e) => FormatError::io(&path, "write", e).into(),
            other => video(&path, other),
        })?;
        muxer.into_writer().commit()?;
        Ok(FilmStats { frames, seconds: frames as f64 / fps })
    }
}

/// An encoder for pictures of `w` × `h` pixels with a constant quantiser.
fn encoder(w: u32, h: u32, fps: f64, quantiser: u8) -> Result<Encoder, openh264::Error> {
    let rate = (BITS_PER_PIXEL * f64::from(w) * f64::from(h) * fps).min(1e8);
    let config = EncoderConfig::new()
        .usage_type(UsageType::CameraVideoRealTime)
        .complexity(Complexity::Medium)
        // The one mode that neither skips frames nor changes the quantiser within its range, here a single value.
        .rate_control_mode(RateControlMode::Bufferbased)
        .qp(QpRange::new(quantiser, quantiser))
        .bitrate(BitRate::from_bps(rate as u32))
        .max_frame_rate(FrameRate::from_hz(fps as f32))
        .intra_frame_period(IntraFramePeriod::from_num_frames((KEY_SECONDS * fps).round() as u32))
        .vui(VuiConfig::bt709())
        // Every frame counts, and the same frames must give the same film on every machine.
        .skip_frames(false)
        .num_threads(1)
        .scene_change_detect(false)
        // Made for webcams: it freezes what hardly moves, which here is slow flow.
        .background_detection(false);
    Encoder::with_api_config(OpenH264API::from_source(), config)
}

fn video(path: &Path, reason: impl std::fmt::Display) -> FilmError {
    FilmError::Video { path: path.to_path_buf(), reason: reason.to_string() }
}

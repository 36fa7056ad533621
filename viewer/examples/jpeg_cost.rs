//! Processor time of a JPEG by the encoders that the viewer can be built with, in turns that
//! alternate: `jpeg_cost FILE.rgba WIDTH HEIGHT [TURNS COUNT]` (`scripts/jpeg_cost.py` makes such a
//! file of a picture). Prints the median of the turns, milliseconds a picture, and bytes: of the
//! quality of moving pictures, then of that at rest.

#![expect(clippy::print_stdout, reason = "what it prints is what it is for")]

use jpeg_encoder::{ColorType, SamplingFactor};
use rustix::time::{ClockId, clock_gettime};
use turbojpeg::{Compressor, Image, PixelFormat, Subsamp};

/// A picture, RGBA.
struct Pixels {
    rgba: Vec<u8>,
    size: [u16; 2],
}

type Encode = fn(&Pixels, u8, bool) -> Result<usize, Box<dyn std::error::Error>>;

fn processor_ms() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
}

fn by_rust(pixels: &Pixels, quality: u8, is_halved: bool) -> Result<usize, Box<dyn std::error::Error>> {
    let mut jpeg = Vec::with_capacity(pixels.rgba.len() / 16);
    let mut encoder = jpeg_encoder::Encoder::new(&mut jpeg, quality);
    encoder.set_sampling_factor(if is_halved { SamplingFactor::F_2_2 } else { SamplingFactor::F_1_1 });
    let [width, height] = pixels.size;
    encoder.encode(&pixels.rgba, width, height, ColorType::Rgba)?;
    Ok(jpeg.len())
}

fn by_turbo(pixels: &Pixels, quality: u8, is_halved: bool) -> Result<usize, Box<dyn std::error::Error>> {
    let mut compressor = Compressor::new()?;
    compressor.set_quality(quality.into());
    compressor.set_subsamp(if is_halved { Subsamp::Sub2x2 } else { Subsamp::None });
    let [width, height] = pixels.size.map(usize::from);
    let image = Image { pixels: &pixels.rgba[..], width, pitch: 4 * width, height, format: PixelFormat::RGBA };
    Ok(compressor.compress_to_vec(image)?.len())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (file, numbers) = arguments.split_first().ok_or("usage: jpeg_cost FILE.rgba WIDTH HEIGHT [TURNS COUNT]")?;
    let numbers: Vec<u16> = numbers.iter().map(|text| text.parse()).collect::<Result<_, _>>()?;
    let (size, [turns, count]) = match numbers[..] {
        [width, height] => ([width, height], [7, 40]),
        [width, height, turns, count] => ([width, height], [turns.max(1), count.max(1)]),
        _ => return Err("usage: jpeg_cost FILE.rgba WIDTH HEIGHT [TURNS COUNT]".into()),
    };
    let pixels = Pixels { rgba: std::fs::read(file)?, size };
    let encoders: [(&str, Encode); 2] = [("jpeg-encoder", by_rust), ("libjpeg-turbo", by_turbo)];
    for (quality, is_halved) in [(75, true), (90, false)] {
        let (mut times, mut bytes) = ([Vec::new(), Vec::new()], [0; 2]);
        for _ in 0..turns {
            for (index, (_, encode)) in encoders.iter().enumerate() {
                let begun = processor_ms();
                for _ in 0..count {
                    bytes[index] = encode(&pixels, quality, is_halved)?;
                }
                times[index].push((processor_ms() - begun) / f64::from(count));
            }
        }
        for (index, (name, _)) in encoders.iter().enumerate() {
            times[index].sort_by(f64::total_cmp);
            let (own, last) = (&times[index], times[index].len() - 1);
            println!(
                "{name:14} quality {quality}: {:6.2} ms ({:.2} to {:.2}), {} bytes, {}x{}",
                own[last / 2],
                own[0],
                own[last],
                bytes[index],
                size[0],
                size[1]
            );
        }
    }
    Ok(())
}

//! `--preview tev`: what a viewer is sent, and that none holds up a render.

use std::io::Read as _;
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use crate::profile::scene;
use crate::support::{Folder, code, majorant, stderr};

/// A packet of the viewer's protocol, as far as the program sends it.
#[derive(Debug, PartialEq)]
enum Packet {
    Create {
        name: String,
        size: [u32; 2],
        channels: Vec<String>,
    },
    Update {
        name: String,
        place: [u32; 4],
        values: Vec<f32>,
    },
}

/// Reads a packet as its specification says; `None` at the end.
fn packet(stream: &mut TcpStream) -> Option<Packet> {
    let mut length = [0; 4];
    stream.read_exact(&mut length).ok()?;
    let mut bytes = vec![0; u32::from_le_bytes(length) as usize - 4];
    stream.read_exact(&mut bytes).expect("as long as it says");
    let mut rest = Rest(&bytes);
    let kind = rest.take(2)[0];
    let name = rest.text();
    Some(match kind {
        4 => {
            let size = [rest.number(), rest.number()];
            let channels = rest.channels();
            assert!(rest.0.is_empty(), "{} bytes too many", rest.0.len());
            Packet::Create {
                name,
                size,
                channels,
            }
        }
        6 => {
            let channels = rest.channels();
            let place = [0; 4].map(|_| rest.number());
            let offsets: Vec<_> = channels.iter().map(|_| rest.long()).collect();
            let strides: Vec<_> = channels.iter().map(|_| rest.long()).collect();
            let expected = (vec![0, 1, 2, 3], vec![4; 4]);
            assert_eq!((offsets, strides), expected, "pixel by pixel");
            let values = rest.0.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b));
            Packet::Update {
                name,
                place,
                values: values.collect(),
            }
        }
        other => panic!("a packet of type {other}"),
    })
}

/// What is left of a packet.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, n: usize) -> &'a [u8] {
        let (taken, left) = self.0.split_at(n);
        self.0 = left;
        taken
    }

    fn number(&mut self) -> u32 {
        u32::from_le_bytes(self.take(4).try_into().expect("four bytes"))
    }

    fn long(&mut self) -> u64 {
        u64::from_le_bytes(self.take(8).try_into().expect("eight bytes"))
    }

    fn text(&mut self) -> String {
        let end = self.0.iter().position(|&b| b == 0).expect("texts end");
        let text = String::from_utf8_lossy(self.take(end)).into_owned();
        self.take(1);
        text
    }

    fn channels(&mut self) -> Vec<String> {
        let count = self.number();
        (0..count).map(|_| self.text()).collect()
    }
}

#[test]
fn a_viewer_is_shown_the_image_as_it_converges() {
    let folder = Folder::new();
    let (scene, image) = (scene(&folder, ""), folder.path("i.exr"));
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let viewer = format!("tev={}", listener.local_addr().unwrap());
    let packets = std::thread::Builder::new().spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        std::iter::from_fn(|| packet(&mut stream)).collect::<Vec<_>>()
    });
    // Long enough for an image on the way, on any machine: those come after a second at the earliest.
    let run = majorant(&[
        "render",
        &scene,
        "-r",
        "32x18",
        "-o",
        &image,
        "--preview",
        &viewer,
        "--spp",
        "1000000",
        "--time-limit",
        "3s",
    ]);
    assert_eq!(code(&run), 75, "{}", stderr(&run));
    let packets = packets.unwrap().join().unwrap();
    let [
        Packet::Create {
            name,
            size,
            channels,
        },
        updates @ ..,
    ] = &packets[..]
    else {
        panic!("{packets:?}")
    };
    assert_eq!((name, size), (&image, &[32, 18]));
    assert_eq!(channels.join(""), "RGBA");
    assert!(!updates.is_empty());
    for update in updates {
        let Packet::Update {
            name,
            place,
            values,
        } = update
        else {
            panic!("{update:?}")
        };
        assert_eq!((name, place), (&image, &[0, 0, 32, 18]));
        assert_eq!(values.len(), 32 * 18 * 4);
        // The corner is sky: of radiance 1 and transparent.
        assert_eq!(values[..4], [1.0, 1.0, 1.0, 0.0]);
        assert!(
            values.iter().skip(3).step_by(4).any(|&a| a > 0.5),
            "some cloud"
        );
    }
}

#[test]
fn a_finished_image_is_shown_to_the_end_and_no_viewer_holds_up_a_render() {
    let folder = Folder::new();
    let (scene, image) = (scene(&folder, ""), folder.path("i.exr"));
    let render = |viewer: &str| {
        let begin = Instant::now();
        let run = majorant(&[
            "render",
            &scene,
            "-r",
            "640x360",
            "--spp",
            "1",
            "-o",
            &image,
            "--preview",
            viewer,
        ]);
        assert_eq!(code(&run), 0, "{}", stderr(&run));
        (stderr(&run), begin.elapsed())
    };
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let viewer = format!("tev={address}");
    let accept = std::thread::Builder::new().spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let shown = std::iter::from_fn(|| packet(&mut stream));
        (shown.last(), listener)
    });
    render(&viewer);
    let (shown, listener) = accept.unwrap().join().unwrap();
    let Some(Packet::Update { values, .. }) = shown else {
        panic!("{shown:?}")
    };
    let file = exr::prelude::read_first_flat_layer_from_file(&image).unwrap();
    let channels = file.layer_data.channel_data.list;
    for (i, name) in ["R", "G", "B", "A"].into_iter().enumerate() {
        let channel = channels.iter().find(|c| c.name.eq(name)).unwrap();
        let written = channel.sample_data.values_as_f32();
        for (a, b) in values.iter().skip(i).step_by(4).zip(written) {
            // The file has halves: 11 bits.
            assert!((a - b).abs() <= a.abs() / 2048.0 + 1e-6, "{name}: {a}, {b}");
        }
    }
    // Connections wait in the listener's queue and nothing reads: 3.7 MB are more than sockets hold.
    let (_, stalled) = render(&viewer);
    assert!(stalled < Duration::from_mins(1), "{stalled:?}");
    // One that goes away after a few bytes.
    let vanish = std::thread::Builder::new().spawn(move || {
        for _ in 0..2 {
            let (mut stream, _) = listener.accept().unwrap();
            let _ = stream.read(&mut [0; 16]);
        }
    });
    let (_, _) = render(&viewer);
    vanish.unwrap().join().unwrap();
    // None at all.
    let (said, _) = render(&viewer);
    assert!(
        said.contains(&format!("no preview in tev at {address}")),
        "{said}"
    );
    let run = majorant(&["render", &scene, "--preview", "xview"]);
    assert_eq!(code(&run), 2);
    assert!(stderr(&run).contains("expected tev"), "{}", stderr(&run));
}

//! `majorant profile` and `--preview tev`, run as programs.

mod cli_support;

use std::io::Read as _;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::time::{Duration, Instant};

use cli_support::{Folder, code, majorant, stderr, stdout};
use serde_json::Value;

fn data_file(name: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    root.join("data").join(name).display().to_string()
}

/// Writes a scene of the cloud with a sun and a sky.
fn scene(folder: &Folder, more: &str) -> String {
    let volume = data_file("cloud.vdb");
    let text = format!(
        "[camera]\nposition = [0.6, -3.4, 0]\nlook_at = [0, 0, 0]\nvertical_fov_degrees = 24\n[[volume]]\nfile = {volume:?}\n\
         density = {{ scale = 84.0 }}\nphase = {{ type = \"henyey-greenstein\", g = 0.7 }}\n\
         {more}[[light]]\ntype = \"distant\"\ndirection_to_light = [1, 0, 1]\nirradiance = [3, 3, 3]\n\
         [[light]]\ntype = \"constant\"\nradiance = [1, 1, 1]\n[render]\nspp = 3\n"
    );
    folder.write("scene.toml", &text)
}

/// Returns the JSON that a page holds.
fn data(page: &str) -> Value {
    const BEGIN: &str = "<script type=\"application/json\" id=\"data\">";
    let begin = page.find(BEGIN).expect("the page has data") + BEGIN.len();
    let length = page[begin..].find("</script>").expect("and they end");
    serde_json::from_str(&page[begin..begin + length]).expect("they are JSON")
}

/// Checks what must hold of every profile; `counted` is a render's `--stats-json`.
fn check(profile: &Value, counted: &Value) {
    assert_eq!(profile["stats"]["counts"], counted["counts"], "exact");
    let work = profile["work"].as_array().expect("a list");
    let of = |work: &Value, key: &str| work[key].as_f64().expect("a number");
    assert_eq!(work.len(), 5, "four kinds and the rest");
    let total: f64 = work.iter().map(|w| of(w, "share")).sum();
    assert!((total - 1.0).abs() < 1e-9, "all of the time: {total}");
    let path = profile["nanoseconds_per_path"].as_f64().expect("a number");
    for one in work {
        let product = of(one, "events_per_path") * of(one, "nanoseconds");
        let said = of(one, "nanoseconds_per_path");
        assert!((product - said).abs() <= 1e-9 * path, "{one}");
        assert!(
            (said - of(one, "share") * path).abs() <= 1e-9 * path,
            "{one}"
        );
    }
    let measured = &profile["measured"];
    let number = |key: &str| measured[key].as_u64().expect("a count");
    // Work is what was counted in the tiles, in which every path has a camera ray.
    let per_path =
        measured["counts"]["segments"].as_f64().expect("a count") / number("paths") as f64;
    let said = of(&work[1], "events_per_path");
    assert!((said - per_path).abs() < 1e-9, "{said} for {per_path}");
    let rays = measured["counts"]["camera_rays"].as_u64();
    assert!(rays >= Some(number("paths")), "{rays:?}");
    // A memory of more bricks finds no less; nothing is found that was not read.
    let reuse = &measured["reuse"];
    let found: Vec<_> = reuse["found"]
        .as_array()
        .expect("a list")
        .iter()
        .map(Value::as_u64)
        .collect();
    assert!(found.is_sorted(), "{found:?}");
    assert!(found.last() <= Some(&reuse["reads"].as_u64()), "{reuse}");
    assert_eq!(profile["machine_counters"]["read"], false, "it says so");
}

#[test]
fn a_profile_has_the_counts_of_a_render_and_needs_nothing_else() {
    let folder = Folder::new();
    let (page, stats, image) = (
        folder.path("p.html"),
        folder.path("s.json"),
        folder.path("i.exr"),
    );
    let scene = scene(&folder, "");
    let run = majorant(&[
        "profile", &scene, "-r", "40x24", "-o", &page, "--json", "-j", "2",
    ]);
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let run_again = majorant(&[
        "render",
        &scene,
        "-r",
        "40x24",
        "-o",
        &image,
        "--stats-json",
        &stats,
    ]);
    assert_eq!(code(&run_again), 0, "{}", stderr(&run_again));
    let read = |path: &str| std::fs::read_to_string(path).expect("written");
    let page = read(&page);
    let counted: Value = serde_json::from_str(&read(&stats)).expect("JSON");
    assert!(counted["counts"]["lookups"].as_u64() > Some(1000));
    let profile = data(&page);
    let printed: Value = serde_json::from_str(&stdout(&run)).expect("JSON");
    assert_eq!(profile, printed);
    check(&profile, &counted);
    let reads = &profile["measured"]["reuse"]["reads"];
    assert!(reads.as_u64() > Some(1000), "{reads}");
    // The image and two maps, all in the page; no script but the data, and no address of a network.
    assert_eq!(page.matches("src=\"data:image/png;base64,").count(), 3);
    assert_eq!(
        (
            page.matches("src=").count(),
            page.matches("<script").count()
        ),
        (3, 1)
    );
    assert!(!page.contains("://") && !page.contains("<link") && !page.contains("@import"));
}

#[test]
fn media_that_absorb_overlap_or_have_a_colour_are_profiled_too() {
    let folder = Folder::new();
    let volume = data_file("smoke.vdb");
    let second = format!("[[volume]]\nfile = {volume:?}\n");
    for more in [
        "albedo = [0, 0, 0]\n",
        "extinction_color = [1, 0.5, 0.25]\n",
        &second,
    ] {
        let (stats, image) = (folder.path("s.json"), folder.path("i.exr"));
        let scene = scene(&folder, more);
        let run = majorant(&["profile", &scene, "-r", "16x9", "--json"]);
        assert_eq!(code(&run), 0, "{more}: {}", stderr(&run));
        let again = majorant(&[
            "render",
            &scene,
            "-r",
            "16x9",
            "-o",
            &image,
            "--stats-json",
            &stats,
        ]);
        assert_eq!(code(&again), 0, "{more}: {}", stderr(&again));
        let counted = std::fs::read_to_string(&stats).expect("written");
        let counted: Value = serde_json::from_str(&counted).expect("JSON");
        let profile: Value = serde_json::from_str(&stdout(&run)).expect("JSON");
        check(&profile, &counted);
    }
}

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

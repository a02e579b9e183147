//! `--preview tev`: the image in the viewer tev, over its TCP protocol, as it converges.
//!
//! A thread of its own talks to the viewer and takes the newest image whenever it is done with one:
//! a viewer that is slow misses some, one that stalls or goes away is left alone, and none holds
//! up rendering.
//!
//! # Packets
//! Each begins with its length in bytes, these four included; numbers are little endian, texts end
//! with a zero.
//!
//! ```text
//! u32 length, 4, u8 focus, name, i32 width, i32 height, i32 n, n names of channels      create
//! u32 length, 6, u8 focus, name, i32 n, n names of channels, i32 x, y, width, height,
//!     n × i64 offsets, n × i64 strides, f32 values                                      update
//! ```

use std::io::{self, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use majorant::film::Film;

use crate::cli::Failure;

/// Time between two images.
const INTERVAL: Duration = Duration::from_secs(1);

/// A viewer that takes longer to answer, or to take some bytes, is none.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long the program waits, at its end, for the last image to be taken.
const FAREWELL: Duration = Duration::from_secs(2);

/// Channels of an image, by name.
const CHANNELS: [&str; 4] = ["R", "G", "B", "A"];

/// A viewer, or the hope for one.
#[derive(Debug)]
pub(super) struct Viewer {
    mail: Arc<Mail>,
    shown: Instant,
}

/// An image on its way.
#[derive(Debug)]
struct Shown {
    name: String,
    width: u32,
    height: u32,
    /// `[pixel][channel]`.
    values: Vec<f32>,
}

/// What the two threads share.
#[derive(Debug, Default)]
struct Mail {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// The newest image that has not been taken.
    next: Option<Shown>,
    /// No more will come.
    is_over: bool,
    /// Nobody takes any more.
    is_deaf: bool,
}

impl Mail {
    /// What a thread that panicked left is whole: nothing is done under the lock but setting.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.state());
        self.changed.notify_all();
    }
}

impl Viewer {
    /// Looks for a viewer at `address`, a host and a port, without waiting for it.
    pub(super) fn find(address: &str) -> Result<Self, Failure> {
        let mail = Arc::<Mail>::default();
        let (theirs, address) = (Arc::clone(&mail), address.to_owned());
        let talk = move || {
            if let Err(e) = talk(&address, &theirs) {
                tracing::warn!("no preview in tev at {address}: {e}");
            }
            theirs.change(|state| {
                state.is_deaf = true;
                state.next = None;
            });
        };
        let name = "preview".to_owned();
        let spawned = std::thread::Builder::new().name(name).spawn(talk);
        // Never joined: it may be waiting for the viewer when the program ends.
        spawned.map_err(Failure::failed)?;
        Ok(Self {
            mail,
            shown: Instant::now(),
        })
    }

    /// Shows an image if the last one has been there for a while.
    pub(super) fn show_sometimes(&mut self, path: &Path, film: impl FnOnce() -> Film) {
        if self.shown.elapsed() >= INTERVAL && !self.mail.state().is_deaf {
            self.show(path, &film());
        }
    }

    /// Shows the image that is to become the file at `path`.
    pub(super) fn show(&mut self, path: &Path, film: &Film) {
        if self.mail.state().is_deaf {
            return;
        }
        #[expect(clippy::cast_possible_truncation, reason = "for the eye")]
        let pixel = |p: &majorant::film::Pixel| {
            let [r, g, b] = p.mean.map(|x| x as f32);
            [r, g, b, p.alpha() as f32]
        };
        let shown = Shown {
            // A text ends at a zero.
            name: path.to_string_lossy().replace('\0', ""),
            width: film.width(),
            height: film.height(),
            values: film.pixels().iter().flat_map(pixel).collect(),
        };
        self.mail.change(|state| state.next = Some(shown));
        self.shown = Instant::now();
    }
}

impl Drop for Viewer {
    /// Waits a moment for the last image to be taken.
    fn drop(&mut self) {
        self.mail.change(|state| state.is_over = true);
        let waiting = |state: &mut State| !state.is_deaf;
        // Whatever became of it, rendering is over.
        drop(
            self.mail
                .changed
                .wait_timeout_while(self.mail.state(), FAREWELL, waiting),
        );
    }
}

/// Connects to the viewer, and sends images until there are no more.
fn talk(address: &str, mail: &Mail) -> io::Result<()> {
    let mut stream = connect(address)?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut created = String::new();
    loop {
        let next = {
            let waiting = |state: &mut State| state.next.is_none() && !state.is_over;
            let waited = mail.changed.wait_while(mail.state(), waiting);
            waited.unwrap_or_else(PoisonError::into_inner).next.take()
        };
        let Some(image) = next else {
            return Ok(());
        };
        if image.name != created {
            stream.write_all(&create(&image))?;
        }
        stream.write_all(&update(&image))?;
        created = image.name;
    }
}

fn connect(address: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the host has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(stream) => return Ok(stream),
            Err(e) => last = e,
        }
    }
    Err(last)
}

/// Bytes of a packet.
struct Packet(Vec<u8>);

impl Packet {
    /// Begins a packet of a type, about an image of a name.
    fn new(kind: u8, name: &str) -> Self {
        const FOCUS: u8 = 0;
        // The length is known in the end.
        let packet = Self(vec![0, 0, 0, 0, kind, FOCUS]);
        packet.text(name)
    }

    fn text(mut self, text: &str) -> Self {
        self.0.extend(text.as_bytes());
        self.0.push(0);
        self
    }

    fn numbers(mut self, numbers: &[u32]) -> Self {
        self.0.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
        self
    }

    fn channels(self) -> Self {
        CHANNELS
            .iter()
            .fold(self.numbers(&[4]), |packet, name| packet.text(name))
    }

    fn finish(mut self) -> Vec<u8> {
        // Images of 2³² bytes are beyond what the protocol can say; the viewer refuses.
        let length = u32::try_from(self.0.len()).unwrap_or(u32::MAX);
        self.0[..4].copy_from_slice(&length.to_le_bytes());
        self.0
    }
}

fn create(image: &Shown) -> Vec<u8> {
    let packet = Packet::new(4, &image.name);
    packet
        .numbers(&[image.width, image.height])
        .channels()
        .finish()
}

fn update(image: &Shown) -> Vec<u8> {
    let packet = Packet::new(6, &image.name).channels();
    let mut packet = packet.numbers(&[0, 0, image.width, image.height]);
    // Values of a pixel are side by side.
    for places in [[0_u64, 1, 2, 3], [4; 4]] {
        packet.0.extend(places.iter().flat_map(|n| n.to_le_bytes()));
    }
    packet
        .0
        .extend(image.values.iter().flat_map(|v| v.to_le_bytes()));
    packet.finish()
}

//! The fuzzing machine: numbers drawn by lot, hostile ones among them, bytes changed at random, and the runner.
//!
//! `SKYLINE_FUZZ_CASES=1000000 scripts/test.sh robust_fuzz` runs so many cases, all kinds together; the suite runs
//! [`CASES`]. A case is its kind and its number: the same ones each time, whatever else runs. A failure prints both;
//! `SKYLINE_FUZZ_ONLY=png:1234 scripts/test.sh robust_fuzz` runs that one again.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{RecvTimeoutError, channel},
    },
    time::{Duration, Instant},
};

use crate::allocations::largest;

/// Cases of all kinds together, where nothing else is asked for.
const CASES: u64 = 60_000;

/// Shares of the kinds. What takes longer gets less. units: 1/1000
const SHARES: [(&str, u64); 17] = [
    ("png", 110),
    ("tiff", 110),
    ("raw", 120),
    ("sidecar", 130),
    ("glb", 120),
    ("gltf", 110),
    ("trim", 10),
    ("obj", 70),
    ("city", 2),
    ("heights", 60),
    ("views", 50),
    ("lights", 40),
    ("budget", 30),
    ("spherical", 15),
    ("interior", 8),
    ("texts", 14),
    ("command", 1),
];

/// A case that takes longer than that hangs.
const PATIENCE: Duration = Duration::from_secs(120);
/// So many failures are told.
const MOST_TOLD: usize = 8;

/// What became of a case: taken, refused with an error that is as it should be, or what is wrong.
pub type Verdict = Result<bool, String>;

/// What became of all cases of a kind.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Cases run.
    pub cases: u64,
    /// Of them, those that gave a result; the others gave an error.
    pub taken: u64,
    /// The largest single allocation. units: bytes
    pub largest: usize,
    /// The case that took longest, and how long.
    slowest: (u64, Duration),
    failures: Vec<String>,
}

impl Tally {
    /// At least one in so many was taken, and one refused; nothing is said of a case run alone.
    pub fn expect_both(&self, one_in: u64) {
        let least = self.cases / one_in;
        let refused = self.cases - self.taken;
        assert!(
            self.cases < 50 || (self.taken >= least && refused >= least),
            "of {} cases {} were taken: the lot does not reach both",
            self.cases,
            self.taken
        );
    }
}

/// Runs this kind's cases, each in turn, on a thread that is watched. None of them may panic, hang, allocate more than
/// `most_bytes` at once, or find anything wrong.
pub fn run(
    kind: &'static str,
    most_bytes: usize,
    case: impl Fn(&mut Lot) -> Verdict + Send + 'static,
) -> Tally {
    let cases = cases_of(kind);
    let at = Arc::new(AtomicU64::new(cases.start));
    let (done, is_done) = channel();
    let start = Instant::now();
    {
        let at = at.clone();
        std::thread::spawn(move || {
            // Whether anybody still waits does not matter.
            let _ = done.send(run_all(kind, cases, most_bytes, &at, &case));
        });
    }
    let mut seen = (u64::MAX, Instant::now());
    let tally = loop {
        match is_done.recv_timeout(Duration::from_millis(200)) {
            Ok(tally) => break tally,
            Err(RecvTimeoutError::Timeout) => {
                let number = at.load(Ordering::Relaxed);
                if number != seen.0 {
                    seen = (number, Instant::now());
                }
                assert!(
                    seen.1.elapsed() < PATIENCE,
                    "a case does not end: SKYLINE_FUZZ_ONLY={kind}:{number}"
                );
            }
            Err(RecvTimeoutError::Disconnected) => panic!("the thread of {kind} ended"),
        }
    };
    println!(
        "{kind}: {} cases in {:.1} s, {} taken, {} refused; at most {} bytes at once; case {} took {:?}",
        tally.cases,
        start.elapsed().as_secs_f64(),
        tally.taken,
        tally.cases - tally.taken,
        tally.largest,
        tally.slowest.0,
        tally.slowest.1
    );
    assert!(tally.failures.is_empty(), "{}", tally.failures.join("\n"));
    tally
}

fn run_all(
    kind: &str,
    cases: core::ops::Range<u64>,
    most_bytes: usize,
    at: &AtomicU64,
    case: &impl Fn(&mut Lot) -> Verdict,
) -> Tally {
    let mut tally = Tally::default();
    for number in cases {
        at.store(number, Ordering::Relaxed);
        let mut lot = Lot::of(kind, number);
        let start = Instant::now();
        let (verdict, bytes) = largest(|| catch_unwind(AssertUnwindSafe(|| case(&mut lot))));
        tally.cases += 1;
        if start.elapsed() > tally.slowest.1 {
            tally.slowest = (number, start.elapsed());
        }
        tally.largest = tally.largest.max(bytes);
        let wrong = match verdict {
            Ok(Ok(_)) if bytes > most_bytes => Some(format!("{bytes} bytes at once")),
            Ok(Ok(is_taken)) => {
                tally.taken += u64::from(is_taken);
                None
            }
            Ok(Err(wrong)) => Some(wrong),
            Err(panic) => {
                let text = panic
                    .downcast_ref::<String>()
                    .map(String::as_str)
                    .or_else(|| panic.downcast_ref::<&str>().copied());
                Some(format!("it panicked: {}", text.unwrap_or("of something")))
            }
        };
        if let Some(wrong) = wrong {
            let wrong = format!("SKYLINE_FUZZ_ONLY={kind}:{number}: {wrong}");
            tally.failures.push(wrong);
            if tally.failures.len() >= MOST_TOLD {
                break;
            }
        }
    }
    tally
}

/// Numbers of the cases of a kind that are asked for.
fn cases_of(kind: &str) -> core::ops::Range<u64> {
    if let Ok(only) = std::env::var("SKYLINE_FUZZ_ONLY") {
        let number = only.split_once(':').filter(|(name, _)| *name == kind);
        let number = number.and_then(|(_, number)| number.parse::<u64>().ok());
        return number.map_or(0..0, |number| number..number + 1);
    }
    let all = match std::env::var("SKYLINE_FUZZ_CASES") {
        Ok(cases) => cases.parse().expect("SKYLINE_FUZZ_CASES is a whole number"),
        Err(_) => CASES,
    };
    let share = SHARES.iter().find(|(name, _)| *name == kind);
    let (_, share) = share.expect("every kind has a share");
    0..(all * share).div_ceil(1000)
}

/// What users are told is one clear line.
pub fn one_line(text: &str) -> Result<(), String> {
    if text.trim().is_empty() {
        return Err("an error says nothing".into());
    }
    if let Some(odd) = text.chars().find(|c| c.is_control()) {
        return Err(format!("an error's text has {odd:?} in it: {text:?}"));
    }
    if text.contains("panicked") || text.len() > 1000 {
        return Err(format!("an error's text is none for users: {text}"));
    }
    Ok(())
}

/// An error that is as it should be.
pub fn refused(error: &dyn core::fmt::Display) -> Verdict {
    one_line(&error.to_string()).map(|()| false)
}

/// What has to hold.
pub fn holds(is_so: bool, what: impl FnOnce() -> String) -> Result<(), String> {
    if is_so { Ok(()) } else { Err(what()) }
}

/// Numbers that code is seldom written for.
const HOSTILE: [f64; 26] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::MAX,
    f64::MIN,
    f64::MIN_POSITIVE,
    5e-324,
    f32::MAX as f64,
    f32::MIN as f64,
    f32::MIN_POSITIVE as f64,
    1e-45,
    1e-30,
    1e30,
    -1e30,
    16_777_217.0,
    4_294_967_295.0,
    4_294_967_296.0,
    9_007_199_254_740_993.0,
    65_535.0,
    255.0,
    1e7,
];

/// A source of numbers (splitmix64; Steele, Lea and Flood 2014).
pub struct Lot(u64);

impl Lot {
    /// That of a case.
    pub fn of(kind: &str, number: u64) -> Self {
        let name = kind.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
        let mut lot = Self(name ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        // Cases next to each other begin far apart.
        Self(lot.draw())
    }

    /// The next 64 bits.
    pub fn draw(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    /// Below `end`, and 0 where there is nothing below.
    pub fn below(&mut self, end: usize) -> usize {
        (self.draw() % end.max(1) as u64) as usize
    }

    pub fn one_in(&mut self, many: usize) -> bool {
        self.below(many) == 0
    }

    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }

    /// From 0 to below 1.
    pub fn unit(&mut self) -> f64 {
        (self.draw() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Any number, those that nobody expects among them.
    pub fn f64(&mut self) -> f64 {
        match self.below(5) {
            0 => self.pick(&HOSTILE),
            1 => f64::from_bits(self.draw()),
            2 => 10f64.powf(90.0 * self.unit() - 45.0) * self.pick(&[1.0, -1.0]),
            _ => 200.0 * self.unit() - 100.0,
        }
    }

    pub fn f32(&mut self) -> f32 {
        if self.one_in(5) {
            f32::from_bits(self.draw() as u32)
        } else {
            self.f64() as f32
        }
    }

    /// A sound number from 0 to below `end`, but for one in `many`.
    pub fn mostly(&mut self, end: f64, many: usize) -> f64 {
        if self.one_in(many) {
            self.f64()
        } else {
            self.unit() * end
        }
    }

    pub fn u32(&mut self) -> u32 {
        match self.below(4) {
            0 => self.pick(&[
                0,
                1,
                2,
                3,
                127,
                128,
                255,
                256,
                65_535,
                65_536,
                1 << 30,
                1 << 31,
                u32::MAX - 1,
                u32::MAX,
            ]),
            1 => self.draw() as u32,
            _ => self.below(70) as u32,
        }
    }

    /// So many of them.
    pub fn many<T>(&mut self, count: usize, mut each: impl FnMut(&mut Self) -> T) -> Vec<T> {
        (0..count).map(|_| each(self)).collect()
    }

    /// Changes bytes in one to four ways: bits, words, lengths, pieces cut off, doubled, moved, or from another file.
    pub fn mutate(&mut self, bytes: &mut Vec<u8>, other: &[u8]) {
        for _ in 0..=self.below(4) {
            self.mutate_once(bytes, other);
        }
    }

    fn mutate_once(&mut self, bytes: &mut Vec<u8>, other: &[u8]) {
        let length = bytes.len();
        // More often near the front, where headers are.
        let near = if self.one_in(2) {
            64.min(length)
        } else {
            length
        };
        let at = self.below(near);
        let piece = self.below(24.min(length - at + 1));
        match self.below(10) {
            0 | 1 if length > 0 => bytes[at] ^= 1 << self.below(8),
            2 if length > 0 => bytes[at] = self.pick(&[0, 1, 0x7f, 0x80, 0xff, b'-', b'"', b'\n']),
            3 => self.word(bytes, at, 2),
            4 => self.word(bytes, at, 4),
            5 => bytes.truncate(at),
            6 => drop(bytes.drain(at..at + piece)),
            7 => {
                let copy = bytes[at..at + piece].to_vec();
                let to = self.below(length + 1);
                bytes.splice(to..to, copy);
            }
            8 => {
                let from = self.below(other.len() + 1);
                let end = (from + self.below(64)).min(other.len());
                let over = (at + end - from).min(length);
                bytes.splice(at..over, other[from..end].iter().copied());
            }
            _ => {
                let from = self.below(other.len() + 1);
                bytes.truncate(at);
                bytes.extend(&other[from..]);
            }
        }
    }

    /// Puts a number where a length, an offset or a count may be, in either order of bytes.
    fn word(&mut self, bytes: &mut [u8], at: usize, size: usize) {
        let number = self.u32();
        let mut word = number.to_le_bytes()[..size].to_vec();
        if self.one_in(2) {
            word.reverse();
        }
        for (byte, new) in bytes.iter_mut().skip(at).zip(word) {
            *byte = new;
        }
    }
}

#[test]
fn shares_are_of_one_whole() {
    assert_eq!(SHARES.iter().map(|(_, share)| share).sum::<u64>(), 1000);
}

/// Sabotage: whatever a case can do wrong, the machine notices and tells how to run it again.
#[test]
fn a_case_that_goes_wrong_is_told() {
    let faults: [fn(&mut Lot) -> Verdict; 4] = [
        |lot| {
            if lot.one_in(9) {
                panic!("of a sort")
            } else {
                Ok(true)
            }
        },
        |lot| {
            if lot.one_in(9) {
                Err("wrong".into())
            } else {
                Ok(true)
            }
        },
        |_| refused(&"two\nlines"),
        |lot| Ok(vec![0u8; if lot.one_in(9) { 5_000 } else { 1 }].len() < 9_000),
    ];
    for (fault, what) in faults
        .into_iter()
        .zip(["of a sort", "wrong", "two", "bytes at once"])
    {
        let tally = run_all("texts", 0..200, 4_000, &AtomicU64::new(0), &fault);
        let first = tally.failures.first().expect("it was noticed");
        assert!(
            first.starts_with("SKYLINE_FUZZ_ONLY=texts:") && first.contains(what),
            "{first}"
        );
        assert!(tally.failures.len() <= MOST_TOLD);
    }
    for text in ["", "  ", "a\rb", "thread panicked at"] {
        assert!(one_line(text).is_err(), "{text:?}");
    }
    assert_eq!(one_line("bins must be above 0: take 180 × 360"), Ok(()));
}

#[test]
fn the_lot_is_the_same_each_time_and_reaches_what_is_hostile() {
    let drawn = |number| {
        let mut lot = Lot::of("png", number);
        lot.many(200, Lot::f32)
    };
    let bits = |numbers: Vec<f32>| numbers.into_iter().map(f32::to_bits).collect::<Vec<_>>();
    assert_eq!(bits(drawn(7)), bits(drawn(7)));
    assert_ne!(bits(drawn(7)), bits(drawn(8)));
    let all: Vec<f32> = (0..50).flat_map(drawn).collect();
    for is in [f32::is_nan, f32::is_infinite, f32::is_subnormal] {
        assert!(all.iter().any(|number| is(*number)));
    }
    assert!(
        all.iter()
            .any(|number| *number == 0.0 && number.is_sign_negative())
    );
}

//! A map of hard shadows, held against the twin's verdicts.

use bevy::math::UVec2;

use super::ShadowVerdict;
use crate::reference::outcome::outcome;

/// The GPU's answers to many samples, held against the twin's.
#[derive(Clone, Debug, Default)]
pub struct ShadowTally {
    /// Samples that had to be lit, and are.
    pub lit: usize,
    /// Samples that had to be dark, and are.
    pub dark: usize,
    /// Samples inside the guard band, either answer being legal.
    pub in_band: usize,
    /// Samples whose answer no correct rounding explains.
    pub wrong: Vec<WrongTexel>,
}

/// One sample's wrong answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongTexel {
    /// Its column and row.
    pub sample: UVec2,
    /// What would have been right.
    pub verdict: ShadowVerdict,
    /// What came instead: 255 for lit, 0 for dark, and nothing else of a hard shadow.
    pub visibility: u8,
}

impl ShadowTally {
    /// Counts one sample of a map of hard shadows. Returns whether it is legal.
    pub fn check(&mut self, sample: UVec2, verdict: ShadowVerdict, visibility: u8) -> bool {
        match (verdict, visibility) {
            (ShadowVerdict::Lit, 255) => self.lit += 1,
            (ShadowVerdict::Dark, 0) => self.dark += 1,
            (ShadowVerdict::InBand, 0 | 255) => self.in_band += 1,
            _ => {
                self.wrong.push(WrongTexel {
                    sample,
                    verdict,
                    visibility,
                });
                return false;
            }
        }
        true
    }

    /// All samples counted.
    pub fn samples(&self) -> usize {
        self.lit + self.dark + self.in_band + self.wrong.len()
    }

    /// Adds another's counts.
    pub fn merge(&mut self, other: Self) {
        self.lit += other.lit;
        self.dark += other.dark;
        self.in_band += other.in_band;
        self.wrong.extend(other.wrong);
    }

    /// # Errors
    /// In words, if any answer was wrong, if no sample was decided, or if more than this fraction of the samples was
    /// in the guard band, where nothing but a grey is wrong.
    pub fn verdict(&self, max_in_band_fraction: f64) -> Result<(), String> {
        outcome(
            "samples",
            &self.wrong,
            self.lit + self.dark,
            self.in_band,
            max_in_band_fraction,
        )
    }

    /// Panics with [`verdict`](Self::verdict)'s words.
    ///
    /// # Panics
    /// For tests: if the comparison failed, or compared too little.
    #[track_caller]
    pub fn assert_ok(&self, max_in_band_fraction: f64) {
        if let Err(why) = self.verdict(max_in_band_fraction) {
            panic!("{why}");
        }
    }
}

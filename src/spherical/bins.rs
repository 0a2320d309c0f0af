//! The sphere of directions about a mesh's centre, cut into bins.

use core::f64::consts::{PI, TAU};

use bevy::{math::DVec3, prelude::*};

use super::error::SphericalError;

/// So many bins at most: with their cells, 40 MiB.
pub const MAX_BINS: usize = 1 << 20;

/// How finely directions are told apart: bins of one size in θ and of one size in φ.
///
/// θ, the zenith, goes from 0 at +Y to π at −Y; φ, the azimuth, from 0 at +X by +Z to 2π. Bins are numbered row by row,
/// φ within θ. (What is left of the paper's equation 1 doesn't say which axis is up; +Y is Bevy's.)
#[derive(Reflect, Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[reflect(Default, Clone, Debug, PartialEq, Hash)]
pub struct Bins {
    /// From pole to pole.
    pub theta: u16,
    /// Around.
    pub phi: u16,
}

impl Default for Bins {
    /// The paper's: a degree each.
    fn default() -> Self {
        Self {
            theta: 180,
            phi: 360,
        }
    }
}

impl Bins {
    /// How many there are.
    pub const fn count(self) -> usize {
        self.theta as usize * self.phi as usize
    }

    /// These, if there are any and not too many.
    ///
    /// # Errors
    /// [`SphericalError::Bins`].
    pub fn checked(self) -> Result<Self, SphericalError> {
        if (1..=MAX_BINS).contains(&self.count()) {
            Ok(self)
        } else {
            let Self { theta, phi } = self;
            Err(SphericalError::Bins { theta, phi })
        }
    }

    /// Half as many each way, rounded up.
    pub(super) const fn halved(self) -> Self {
        Self {
            theta: self.theta.div_ceil(2),
            phi: self.phi.div_ceil(2),
        }
    }

    /// Between the borders of a row. units: rad
    pub fn theta_step(self) -> f64 {
        PI / f64::from(self.theta)
    }

    /// Between the borders of a column. units: rad
    pub fn phi_step(self) -> f64 {
        TAU / f64::from(self.phi)
    }

    /// The row that a zenith is in; beyond the poles, the last before them.
    pub fn row(self, theta: f64) -> usize {
        // From a float, `as` goes to the nearest integer there is, and from NaN to 0.
        ((theta / self.theta_step()) as usize).min(usize::from(self.theta) - 1)
    }

    /// The column that an azimuth is in, however often it goes around.
    pub fn column(self, phi: f64) -> usize {
        ((phi.rem_euclid(TAU) / self.phi_step()) as usize).min(usize::from(self.phi) - 1)
    }

    /// The bin that a direction of any length is in. That of no length is in the first.
    pub fn of(self, direction: DVec3) -> usize {
        let (theta, phi) = angles(direction);
        self.row(theta) * usize::from(self.phi) + self.column(phi)
    }

    /// The direction of a bin's middle.
    pub fn middle(self, bin: usize) -> DVec3 {
        let (row, column) = (bin / usize::from(self.phi), bin % usize::from(self.phi));
        direction(
            (row as f64 + 0.5) * self.theta_step(),
            (column as f64 + 0.5) * self.phi_step(),
        )
    }
}

/// θ in 0..=π and φ in −π..=π of a direction of any length; 0 and 0 of none. By arc tangents, which are as exact at the
/// poles as at the equator. units: rad
pub fn angles(direction: DVec3) -> (f64, f64) {
    let DVec3 { x, y, z } = direction;
    let across = x.hypot(z);
    (across.atan2(y), z.atan2(x))
}

/// The direction with these angles; of length 1.
pub fn direction(theta: f64, phi: f64) -> DVec3 {
    let (sin, cos) = theta.sin_cos();
    DVec3::new(sin * phi.cos(), cos, sin * phi.sin())
}

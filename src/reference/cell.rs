//! One bilinear patch and a ray over it: quadratics, and where they change sign.

/// `c + b s + a s²`: how far a ray is above a bilinear patch, as a function of the ray's own parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quadratic {
    /// Value at s = 0.
    pub c: f64,
    /// Slope at s = 0.
    pub b: f64,
    /// Half the second derivative.
    pub a: f64,
}

impl Quadratic {
    /// The value at s.
    pub fn at(self, s: f64) -> f64 {
        self.c + s * (self.b + s * self.a)
    }

    /// The slope at s.
    pub fn slope_at(self, s: f64) -> f64 {
        self.b + 2.0 * self.a * s
    }

    /// The same function, with s counted from `s`.
    pub fn from(self, s: f64) -> Self {
        Self {
            c: self.at(s),
            b: self.slope_at(s),
            a: self.a,
        }
    }

    /// `self + k other`.
    pub fn plus(self, k: f64, other: Self) -> Self {
        Self {
            c: self.c + k * other.c,
            b: self.b + k * other.b,
            a: self.a + k * other.a,
        }
    }

    /// First s ≥ 0 at which the function, not negative at 0, comes down to zero.
    ///
    /// Both forms of the root add terms of one sign, so nothing cancels, and a = 0 needs no case of its own.
    pub fn first_fall(self) -> Option<f64> {
        let Self { c, b, a } = self;
        let discriminant = b * b - 4.0 * a * c;
        if discriminant < 0.0 {
            None
        } else if b < 0.0 {
            Some(2.0 * c / (discriminant.sqrt() - b))
        } else if a < 0.0 {
            Some((b + discriminant.sqrt()) / (-2.0 * a))
        } else {
            None
        }
    }

    /// First s ≥ 0 at which the function, not positive at 0, comes up to zero.
    pub fn first_rise(self) -> Option<f64> {
        Self {
            c: -self.c,
            b: -self.b,
            a: -self.a,
        }
        .first_fall()
    }
}

/// The surface over one cell: `h00 + p u + q v + r u v` with u and v from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Heights of the corners (i, j), (i+1, j), (i, j+1), (i+1, j+1).
    pub corners: [f64; 4],
}

impl Patch {
    fn terms(&self) -> (f64, f64, f64) {
        let [h00, h10, h01, h11] = self.corners;
        (h10 - h00, h01 - h00, (h11 - h01) - (h10 - h00))
    }

    /// Height at (u, v); beyond the cell, its continuation.
    pub fn height(&self, u: f64, v: f64) -> f64 {
        let (p, q, r) = self.terms();
        self.corners[0] + p * u + q * v + r * u * v
    }

    /// Height of the point `(u, y, v) + s (du, dy, dv)` above the patch.
    pub fn above(&self, [u, y, v]: [f64; 3], [du, dy, dv]: [f64; 3]) -> Quadratic {
        let (p, q, r) = self.terms();
        Quadratic {
            c: (y - self.corners[0]) - (p * u + q * v + r * u * v),
            b: dy - p * du - q * dv - r * (u * dv + v * du),
            a: -r * du * dv,
        }
    }

    /// Highest corner, which nothing over the cell exceeds.
    pub fn max(&self) -> f64 {
        self.corners.into_iter().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Lowest corner.
    pub fn min(&self) -> f64 {
        self.corners.into_iter().fold(f64::INFINITY, f64::min)
    }
}

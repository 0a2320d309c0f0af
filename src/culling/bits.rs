//! A set of small numbers, one bit each, laid out as the GPU reads it.

/// A growing set of `u32`, bit `i & 31` of word `i >> 5`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bits(Vec<u32>);

impl Bits {
    /// Takes everything out, keeping the memory, and makes room for numbers below `len`.
    pub fn clear(&mut self, len: usize) {
        self.0.clear();
        self.0.resize(len.div_ceil(32), 0);
    }

    /// Makes room for numbers below `len`.
    pub fn grow(&mut self, len: usize) {
        if self.0.len() < len.div_ceil(32) {
            self.0.resize(len.div_ceil(32), 0);
        }
    }

    /// Puts a number in. There must be room for it.
    pub fn insert(&mut self, i: u32) {
        self.0[(i >> 5) as usize] |= 1 << (i & 31);
    }

    /// Puts a number in or takes it out, and makes room for it.
    pub fn set(&mut self, i: u32, is_in: bool) {
        if is_in {
            self.grow(i as usize + 1);
            self.insert(i);
        } else {
            self.remove(i);
        }
    }

    /// Takes a number out.
    pub fn remove(&mut self, i: u32) {
        if let Some(word) = self.0.get_mut((i >> 5) as usize) {
            *word &= !(1 << (i & 31));
        }
    }

    /// Whether a number is in.
    pub fn contains(&self, i: u32) -> bool {
        self.0
            .get((i >> 5) as usize)
            .is_some_and(|word| word & (1 << (i & 31)) != 0)
    }

    /// How many are in.
    pub fn count(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// How many are in this and not in `other`.
    pub fn count_without(&self, other: &Self) -> usize {
        self.words(other)
            .map(|(word, other)| (word & !other).count_ones() as usize)
            .sum()
    }

    /// Of the numbers in `of`, puts in those that are in `with` and takes out those that are not.
    pub fn set_from(&mut self, of: &Self, with: &Self) {
        self.grow(of.0.len() * 32);
        for (word, (of, with)) in self.0.iter_mut().zip(of.words(with)) {
            *word = (*word & !of) | (of & with);
        }
    }

    /// The words.
    pub fn as_words(&self) -> &[u32] {
        &self.0
    }

    /// The words, to be overwritten.
    pub fn words_mut(&mut self) -> &mut Vec<u32> {
        &mut self.0
    }

    fn words<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = (u32, u32)> + 'a {
        self.0
            .iter()
            .enumerate()
            .map(|(i, word)| (*word, other.0.get(i).copied().unwrap_or(0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(of: &[u32]) -> Bits {
        let mut bits = Bits::default();
        bits.clear(100);
        of.iter().for_each(|i| bits.insert(*i));
        bits
    }

    #[test]
    fn sets_do_what_sets_do() {
        let mut set = bits(&[0, 31, 32, 99]);
        assert_eq!(set.count(), 4);
        assert!(set.contains(32) && !set.contains(33) && !set.contains(4000));
        set.remove(32);
        set.remove(4000);
        assert_eq!(set, bits(&[0, 31, 99]));
        assert_eq!(set.count_without(&bits(&[31, 50])), 2);
        set.set_from(&bits(&[0, 1, 2]), &bits(&[1, 99]));
        assert_eq!(set, bits(&[1, 31, 99]));
        set.set(200, true);
        set.set(31, false);
        set.set(9_000, false);
        assert!(set.contains(200) && !set.contains(31) && !set.contains(9_000));
    }
}

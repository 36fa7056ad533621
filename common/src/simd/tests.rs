//! Every set of instructions that this processor has gives the bits of the portable one.

use super::{Instructions, LANES, Portable, Simd, Sixteen, Work};

use proptest::prelude::*;

/// What all operations make of some numbers, as bits.
struct All {
    floats: [Sixteen<f32>; 2],
    words: [Sixteen<u32>; 2],
    table: Vec<f32>,
}

impl Work for All {
    type Output = Vec<Sixteen<u32>>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Vec<Sixteen<u32>> {
        let [a, b] = [simd.load(&self.floats[0]), simd.load(&self.floats[1])];
        let [m, n] = [simd.load_words(&self.words[0]), simd.load_words(&self.words[1])];
        let (less, at_most) = (simd.less(a, b), simd.at_most(a, b));
        let mut stored = self.floats[0];
        simd.store_where(less, b, &mut stored);
        let whole = simd.to_floats((m & simd.words(0x007f_ffff)) | simd.words(0x3f80_0000)) * simd.floats(1e5);
        let bytes: Vec<u8> = self.table.iter().flat_map(|x| x.to_le_bytes()).collect();
        let [first, second] = simd.pairs(&self.table, m);
        let near_table = std::array::from_fn(|k| self.table.get(k).copied().unwrap_or(k as f32));
        let [near, near_next] = simd.near_pairs(&near_table, simd.shift_right::<28>(m));
        let [first_word, second_word] = simd.texel_pairs(&bytes, simd.shift_right::<26>(m));
        let floats = [
            a + b,
            a - b,
            a * b,
            a / b,
            simd.smaller(a, b),
            simd.larger(a, b),
            simd.select(less | at_most, a, b),
            simd.select(less & at_most, b, a),
            simd.floor(whole),
            simd.magnitude(a),
            simd.floats(stored[3]),
            simd.load(&stored),
            first,
            second,
            near,
            near_next,
        ];
        let words = [
            m + n,
            m - n,
            m * n,
            m & n,
            m | n,
            simd.select_words(less, m, n),
            simd.smaller_words(m, n),
            simd.shift_right::<7>(m),
            simd.shift_left::<9>(m),
            simd.shift_right_by(m, n & simd.words(31)),
            simd.multiply_halves(m, n),
            simd.words(simd.bits(less)),
            simd.words(simd.bits(simd.mask(simd.bits(less)))),
            simd.select_words(simd.mask(self.words[0][0]), m, n),
            simd.words(u32::from(simd.any(at_most))),
            simd.words(simd.smallest(a).to_bits()),
            simd.words(simd.largest(a).to_bits()),
            simd.index(simd.floor(whole)),
            first_word,
            second_word,
        ];
        let of_words = words.map(|words| simd.to_floats(words));
        let bits = |floats| {
            let mut stored = [0.0; LANES];
            simd.store(floats, &mut stored);
            stored.map(f32::to_bits)
        };
        floats.into_iter().chain(of_words).map(bits).collect()
    }
}

fn sixteen<T: std::fmt::Debug + Clone + 'static>(
    of: impl Strategy<Value = T> + Clone,
) -> impl Strategy<Value = [T; LANES]> {
    prop::collection::vec(of, LANES).prop_map(|of| of.try_into().expect("sixteen"))
}

proptest! {
    #[test]
    fn all_instructions_give_the_same_bits(
        a in sixteen(-1e6f32..1e6), b in sixteen(-10.0f32..10.0), m in sixteen(any::<u32>()), n in sixteen(any::<u32>()),
        equal in any::<u16>(), infinite in any::<u16>(), table in prop::collection::vec(-1e3f32..1e3, 0..90),
    ) {
        let mut a = a;
        for (k, a) in a.iter_mut().enumerate() {
            if equal >> k & 1 == 1 { *a = b[k]; }
            if infinite >> k & 1 == 1 { *a = f32::NEG_INFINITY; }
        }
        let work = || All { floats: [a, b], words: [m, n], table: table.clone() };
        let expected = work().run(Portable);
        for instructions in Instructions::all() {
            let found = instructions.run(work());
            for (number, (found, expected)) in found.iter().zip(&expected).enumerate() {
                prop_assert_eq!(found, expected, "result {} by {}", number, instructions.name());
            }
        }
    }
}

#[test]
fn whole_parts_are_those_of_integers() {
    for x in [0.0f32, 0.2, 0.5, 0.99999994, 1.0, 1.5, 2.5, 1000.25, 70001.0] {
        let whole = Portable.floor(Portable.floats(x));
        let mut found = [0.0; LANES];
        Portable.store(whole, &mut found);
        assert_eq!(found, [x.trunc(); LANES]);
        Portable.store(Portable.to_floats(Portable.index(whole)), &mut found);
        assert_eq!(found.map(f32::to_bits), [x as u32; LANES]);
    }
}

#[test]
fn places_beyond_a_table_are_its_last_pair() {
    for count in [0usize, 1, 2, 3, 20] {
        let table: Vec<f32> = (0..count).map(|k| k as f32).collect();
        let at = Portable.load_words(&std::array::from_fn(|k| if k == 15 { u32::MAX } else { k as u32 }));
        let mut found = [[0.0; LANES]; 2];
        for (found, floats) in found.iter_mut().zip(Portable.pairs(&table, at)) {
            Portable.store(floats, found);
        }
        let expected = |k: usize| count.checked_sub(2).map_or(0.0, |last| k.min(last) as f32);
        for (k, (first, second)) in found[0].iter().zip(&found[1]).enumerate() {
            let at = if k == 15 { usize::MAX } else { k };
            let next = if count < 2 { 0.0 } else { expected(at) + 1.0 };
            assert_eq!([*first, *second], [expected(at), next], "{count}, {k}");
        }
    }
}

#[test]
fn instructions_have_names_that_they_are_found_by() {
    for instructions in Instructions::all() {
        assert_eq!(Instructions::named(instructions.name()), Some(instructions));
        assert_eq!(Instructions::named(&instructions.name().to_lowercase()), Some(instructions));
    }
    assert_eq!(Instructions::named("PORTABLE "), Some(Instructions::PORTABLE));
    assert_eq!(Instructions::named("MMX"), None);
}

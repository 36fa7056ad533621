import type { ComponentChildren } from 'preact';
import { useRef, useState } from 'preact/hooks';

interface NumberFieldProps {
  label: string;
  unit?: string;
  /** What is shown while nobody types; empty for none. */
  value: number | null | undefined;
  digits: number;
  step: number;
  low?: number;
  high?: number;
  placeholder?: string;
  /** Taken as an answer when the field is left empty. */
  canBeEmpty?: boolean;
  isDisabled?: boolean;
  change(value: number | null): void;
}

/** A number that is shown live, and can be typed: Enter or leaving the field takes it, Escape does not. */
export function NumberField(props: NumberFieldProps) {
  const [typed, setTyped] = useState<string | undefined>(undefined);
  const input = useRef<HTMLInputElement>(null);
  const shown = props.value == null ? '' : props.value.toFixed(props.digits);
  const parsed = typed === undefined ? undefined : parse(typed, props);

  const take = () => {
    if (parsed !== undefined && parsed !== 'wrong' && typed !== shown) props.change(parsed);
    setTyped(undefined);
  };
  const key = (event: KeyboardEvent) => {
    if (event.key === 'Enter') {
      take();
      input.current?.select();
    } else if (event.key === 'Escape') {
      setTyped(undefined);
      input.current?.blur();
    } else if (event.key === 'ArrowUp' || event.key === 'ArrowDown') {
      event.preventDefault();
      const base = typeof parsed === 'number' ? parsed : props.value;
      if (base == null) return;
      const next = base + (event.key === 'ArrowUp' ? props.step : -props.step);
      setTyped(undefined);
      props.change(Math.min(props.high ?? Infinity, Math.max(props.low ?? -Infinity, next)));
    }
  };
  return (
    <label class="field">
      <span class="field-label">{props.label}</span>
      <span class="field-box">
        <input
          ref={input}
          inputMode="decimal"
          autocomplete="off"
          spellcheck={false}
          placeholder={props.placeholder}
          disabled={props.isDisabled}
          value={typed ?? shown}
          aria-invalid={parsed === 'wrong'}
          onFocus={(event) => event.currentTarget.select()}
          onInput={(event) => setTyped(event.currentTarget.value)}
          onKeyDown={key}
          onBlur={take}
        />
        {props.unit && <span class="field-unit">{props.unit}</span>}
      </span>
    </label>
  );
}

function parse(text: string, { canBeEmpty, low, high }: NumberFieldProps): number | null | 'wrong' {
  const plain = text.trim().replace(/[\s\u202f]/g, '').replace(',', '.');
  if (plain === '') return canBeEmpty ? null : 'wrong';
  const value = Number(plain);
  if (!Number.isFinite(value) || value < (low ?? -Infinity) || value > (high ?? Infinity)) return 'wrong';
  return value;
}

interface ChoiceProps<T extends string> {
  label: string;
  value: T;
  options: readonly (readonly [T, string])[];
  isDisabled?: boolean;
  change(value: T): void;
}

/** One of a few, side by side. */
export function Choice<T extends string>({ label, value, options, isDisabled, change }: ChoiceProps<T>) {
  return (
    <div class="choice" role="group" aria-label={label}>
      {options.map(([option, name]) => (
        <button type="button" key={option} aria-pressed={option === value} disabled={isDisabled} onClick={() => change(option)}>
          {name}
        </button>
      ))}
    </div>
  );
}

interface ButtonProps {
  label?: string;
  title?: string;
  isPrimary?: boolean;
  isDisabled?: boolean;
  class?: string;
  children: ComponentChildren;
  click(): void;
}

export function Button({ label, title, isPrimary, isDisabled, children, click, class: extra }: ButtonProps) {
  const name = `button${isPrimary ? ' primary' : ''}${extra === undefined ? '' : ` ${extra}`}`;
  return (
    <button type="button" class={name} aria-label={label} title={title ?? label} disabled={isDisabled} onClick={click}>
      {children}
    </button>
  );
}

/** A figure and what it is. */
export function Figure({ name, children }: { name: string; children: ComponentChildren }) {
  return (
    <div class="figure">
      <dt>{name}</dt>
      <dd>{children}</dd>
    </div>
  );
}

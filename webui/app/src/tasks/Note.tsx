/** A text of a form: headings, lists, bold words and links of Markdown; everything else as it is written. */
import type { ReactNode } from "react";

export function Note({ text }: { text: string }) {
  return <div className="form-note">{blocks(text)}</div>;
}

function blocks(text: string): ReactNode[] {
  const found: ReactNode[] = [];
  let items: string[] = [];
  const endList = () => {
    if (items.length > 0) {
      const listed = items;
      found.push(<ul key={found.length}>{listed.map((item, nth) => <li key={nth}>{inline(item)}</li>)}</ul>);
    }
    items = [];
  };
  for (const line of text.split("\n")) {
    const item = /^\s*[-*]\s+(.*)/.exec(line)?.[1];
    if (item !== undefined) {
      items.push(item);
      continue;
    }
    endList();
    const heading = /^#{1,6}\s+(.*)/.exec(line)?.[1];
    if (heading !== undefined) found.push(<h3 key={found.length}>{inline(heading)}</h3>);
    else if (line.trim() !== "") found.push(<p key={found.length}>{inline(line)}</p>);
  }
  endList();
  return found;
}

function inline(text: string): ReactNode[] {
  return text.split(/(\*\*[^*]+\*\*|\[[^\]]+\]\(https?:\/\/[^)\s]+\))/).map((part, nth) => {
    const bold = /^\*\*([^*]+)\*\*$/.exec(part)?.[1];
    if (bold !== undefined) return <strong key={nth}>{bold}</strong>;
    const link = /^\[([^\]]+)\]\(([^)]+)\)$/.exec(part);
    if (link !== null) return <a key={nth} href={link[2]} target="_blank" rel="noreferrer">{link[1]}</a>;
    return part;
  });
}

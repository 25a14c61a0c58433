// SPDX-License-Identifier: GPL-2.0-or-later
import { useEffect, useState } from "preact/hooks";

/** A QR code as one path of an SVG. The encoder is loaded when it is wanted first; without the server the place says so. */
export function Qr({ text, label }: { readonly text: string; readonly label: string }): preact.JSX.Element {
    const [path, setPath] = useState<{ readonly d: string; readonly size: number }>();
    const [failed, setFailed] = useState(false);
    useEffect(() => {
        let wanted = true;
        void import("qrcode-generator").then(({ default: encode }) => {
            if (!wanted) return;
            const code = encode(0, "M");
            code.addData(text);
            code.make();
            const size = code.getModuleCount();
            let d = "";
            for (let row = 0; row < size; ++row) for (let column = 0; column < size; ++column) if (code.isDark(row, column)) d += `M${column} ${row}h1v1h-1z`;
            setPath({ d, size });
        }, () => wanted && setFailed(true));
        return () => void (wanted = false);
    }, [text]);
    if (path === undefined) return <div class="qr">{failed && "The code cannot be drawn without the server."}</div>;
    return (
        <svg class="qr" viewBox={`-4 -4 ${path.size + 8} ${path.size + 8}`} role="img" aria-label={label} shape-rendering="crispEdges">
            <rect x="-4" y="-4" width={path.size + 8} height={path.size + 8} fill="#fff" />
            <path d={path.d} fill="#000" />
        </svg>
    );
}

"""The page that `show_move` fills: a small 3D viewer of its own, without any library or network access.

Everything round is a surface of revolution about its axis. All polygons of a frame are shaded by one lamp and
painted from the farthest to the nearest; what the arm could touch is translucent.
"""

PAGE = """<!doctype html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width"><title>%TITLE%</title>
<style>body{font:15px system-ui,sans-serif;margin:20px auto;padding:0 16px;color:#222;background:#fff;max-width:1120px}
canvas{width:100%;height:min(560px,70vw);background:linear-gradient(#eef3f8,#fff);border:1px solid #ddd;
border-radius:6px;cursor:grab;touch-action:none}
.bar{display:flex;gap:12px;align-items:center}.bar input{flex:1}button{min-width:5em}
.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(440px,100%),1fr));gap:8px;margin-top:12px}
svg text{font-size:11px}svg .name{font-size:13px;font-weight:600}.end{text-anchor:end}.mid{text-anchor:middle}
polyline{fill:none;stroke-width:1.4}.frame{fill:none;stroke:#bbb}.grid{stroke:#eee}
.limit{fill:none;stroke:#555;stroke-dasharray:5 4}.now{stroke:#111;stroke-width:1}</style>
<h1>%TITLE%</h1>
<div class="bar"><button id="play">pause</button>
<input id="at" type="range" min="0" max="1" step="0.001" value="0" aria-label="time"><output id="time"></output></div>
<p>Drag to turn, wheel to zoom. Red: the way of the cone's apex. Green: where it stands at the stations.</p>
<canvas id="view"></canvas><div class="plots">%PLOTS%</div>
<script>
const D=%DATA%,byId=id=>document.getElementById(id),c=byId("view"),g=c.getContext("2d");
const slider=byId("at"),play=byId("play"),marks=[...document.querySelectorAll(".now")];
let yaw=-2.2,pitch=.3,zoom=1,share=0,playing=true,last=null;
const SIDES=[[0,1,3,2],[4,6,7,5],[0,4,5,1],[2,3,7,6],[0,2,6,4],[1,5,7,3]],AROUND=20;
const COLOUR={capsule:[122,152,196],cylinder:[104,116,134],clamps:[214,178,128],cone:[255,150,30],arm:[104,116,134]};
const sub=(a,b)=>a.map((v,i)=>v-b[i]),dot=(a,b)=>a[0]*b[0]+a[1]*b[1]+a[2]*b[2];
const cross=(a,b)=>[a[1]*b[2]-a[2]*b[1],a[2]*b[0]-a[0]*b[2],a[0]*b[1]-a[1]*b[0]];
const unit=a=>{const l=Math.hypot(...a)||1;return a.map(v=>v/l)};
/* To the camera: right, up, away [m]. */
function seen(p){const x=p[0]-.17,y=p[1],z=p[2]-.19,b=Math.sin(yaw)*x+Math.cos(yaw)*y;
return [Math.cos(yaw)*x-Math.sin(yaw)*y,Math.sin(pitch)*b+Math.cos(pitch)*z,Math.cos(pitch)*b-Math.sin(pitch)*z]}
function onto(s){const k=zoom*2.5*Math.min(c.width/1.5,c.height)/(1.6+s[2]);return [c.width/2+s[0]*k,c.height/2-s[1]*k]}
/* A surface of revolution as polygons: its outline is pairs of a place on the axis and a radius. */
function turned(a,b,r,kind){const n=unit(sub(b,a)),l=Math.hypot(...sub(b,a)),outline=[];
if(kind=="capsule")for(let k=0;k<=10;k++){const t=Math.PI*(k>5?k-1:k)/9;
outline.push([(k>5?l:0)-r*Math.cos(t),r*Math.sin(t)])}
else outline.push([0,0],[0,r],...(kind=="cone"?[]:[[l,r]]),[l,0]);
const e=unit(cross(n,Math.abs(n[2])<.9?[0,0,1]:[1,0,0])),f=cross(n,e),rings=outline.map(([t,w])=>
[...Array(AROUND).keys()].map(k=>{const u=Math.cos(2*Math.PI*k/AROUND)*w,v=Math.sin(2*Math.PI*k/AROUND)*w;
return a.map((o,i)=>o+n[i]*t+e[i]*u+f[i]*v)}));
const found=[];for(let i=0;i+1<rings.length;i++)for(let k=0;k<AROUND;k++){const m=(k+1)%AROUND;
found.push([rings[i][k],rings[i][m],rings[i+1][m],rings[i+1][k]])}return found}
/* What stands still: its faces, and which of them have their edges drawn. */
const standing=D.solids.map(s=>{if(s.corners)return {...s,faces:SIDES.map(f=>[f.map(k=>s.corners[k]),true])};
const round=turned(...s.ends,s.radius,"cylinder").slice(AROUND,2*AROUND);
return {...s,faces:[...round.map(f=>[f,false]),[round.map(q=>q[0]),true],[round.map(q=>q[3]),true]]}});
function add(list,polygon,colour,glass,edged){const p=polygon.map(seen);
let n=unit(cross(sub(p[2],p[0]),sub(p[3],p[1])));
const middle=[0,1,2].map(i=>p.reduce((s,q)=>s+q[i],0)/p.length);
if(dot(n,[middle[0],middle[1],middle[2]+1.6])>0)n=n.map(v=>-v);
const light=.74+.3*Math.max(0,dot(n,[-.4,.75,-.53])),rgb=`rgb(${colour.map(v=>Math.min(255,Math.round(v*light)))})`;
list.push([middle[2],p.map(onto),glass?"rgba(138,160,182,.20)":rgb,glass?edged&&"rgba(84,100,118,.55)":rgb])}
function line(points,style,width){g.strokeStyle=style;g.lineWidth=width;g.beginPath();
points.map(p=>onto(seen(p))).forEach((q,i)=>i?g.lineTo(...q):g.moveTo(...q));g.stroke()}
/* A name beside its point, unless it would cover one that is there already. */
function label(text,p,colour,size,there){const [x,y]=onto(seen(p)),box=[x+7,y-size,x+7+g.measureText(text).width,y];
if(there.some(o=>o[0]<box[2]&&box[0]<o[2]&&o[1]<box[3]&&box[1]<o[3]))return;there.push(box);
g.lineWidth=3;g.strokeStyle="#ffffffd0";g.fillStyle=colour;g.strokeText(text,x+7,y-3);g.fillText(text,x+7,y-3)}
function draw(){const ratio=window.devicePixelRatio||1;
const w=Math.round(c.clientWidth*ratio),h=Math.round(c.clientHeight*ratio);
if(c.width!=w||c.height!=h){c.width=w;c.height=h}
g.clearRect(0,0,w,h);g.lineJoin="round";g.font=`${12*ratio}px system-ui,sans-serif`;
for(let k=0;k<=10;k++){line([[k*.1-.3,-.5,0],[k*.1-.3,.5,0]],"#dde4ea",ratio);
line([[-.3,k*.1-.5,0],[.7,k*.1-.5,0]],"#dde4ea",ratio)}
const now=Math.min(share,1),list=[],there=[];
D.frames[Math.round(now*(D.frames.length-1))].forEach(([kind,r,a,b])=>
turned(a,b,r,kind).forEach(p=>add(list,p,COLOUR[kind],false,true)));
standing.forEach(s=>s.faces.forEach(([p,edged])=>add(list,p,COLOUR.arm,!s.arm,edged)));
list.sort((a,b)=>b[0]-a[0]).forEach(([,points,fill,edge])=>{g.beginPath();
points.forEach((q,i)=>i?g.lineTo(...q):g.moveTo(...q));g.closePath();
g.fillStyle=fill;g.fill();if(edge){g.strokeStyle=edge;g.lineWidth=ratio*.7;g.stroke()}});
line(D.path,"#c62828",2*ratio);
Object.entries(D.places).forEach(([name,p])=>{line([p,[p[0],p[1],0]],"#1a7f3766",ratio);
g.fillStyle="#1a7f37";g.beginPath();g.arc(...onto(seen(p)),3.5*ratio,0,7);g.fill();
label(name,p,"#14662c",12*ratio,there)});
D.solids.forEach(s=>{if(!s.name||s.name in D.places)return;const all=s.corners||s.ends;
const top=[0,1,2].map(i=>i<2?all.reduce((t,q)=>t+q[i],0)/all.length:Math.max(...all.map(q=>q[2])));
label(s.name,top,"#556270",12*ratio,there)});
byId("time").textContent=`${(now*D.duration).toFixed(2)} of ${D.duration.toFixed(2)} s`;
marks.forEach(m=>m.setAttribute("transform",`translate(${now*m.dataset.travel} 0)`))}
function tick(now){if(playing&&last!==null){share=(share+(now-last)/1000/D.duration)%1.25;
slider.value=Math.min(share,1)}
last=now;draw();requestAnimationFrame(tick)}
function hold(stop){playing=!stop;play.textContent=stop?"play":"pause"}
slider.oninput=()=>{hold(true);share=+slider.value};play.onclick=()=>hold(playing);
c.onpointerdown=e=>{c.setPointerCapture(e.pointerId);c.onpointermove=e=>{yaw+=e.movementX*.008;
pitch=Math.max(-.2,Math.min(1.55,pitch+e.movementY*.006))}};
c.onpointerup=()=>{c.onpointermove=null};
c.addEventListener("wheel",e=>{e.preventDefault();zoom=Math.max(.4,Math.min(6,zoom*Math.exp(-e.deltaY*.001)))},{passive:false});
requestAnimationFrame(tick);
</script></html>
"""
